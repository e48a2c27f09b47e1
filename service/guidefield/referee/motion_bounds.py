"""The motion of a robot and of obstacles in segments: placements in their middles, and bounds about these.

In a segment the columns of the motion are at z + x, with z in its middle. With D the chord from its first point to its
last, x = l D + e. A body goes along l by the twist J D; its points are at most `bent` off that, and `travel` from
where they are in the middle. Every bound is that of docs/certificate.md, by Pinocchio's Jacobians: with a smaller one
`replay.py` would accept false proofs, with a larger one refuse true ones.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Literal, NamedTuple

import numpy as np
import pinocchio as pin

from guidefield.referee.case import Body, Case, expand_about, pieces
from guidefield.referee.proof import Declared, declared, radius_about


class ChordBounds(NamedTuple):
    """The motion's columns in s segments."""

    z: np.ndarray  # in the middles, shape (s, n)
    chords: np.ndarray  # D, shape (s, n)
    shares: np.ndarray  # bound on |l|, shape (s,)
    farthest: np.ndarray  # bound on |x| of each column, shape (s, n)
    sideways: np.ndarray  # bound on |e| of each column, shape (s, n)


class BodyBounds(NamedTuple):
    """How a body moves in each of s segments."""

    twist: np.ndarray  # by which it moves along D, linear part first, shape (s, 6) [m and rad, world]
    bent: np.ndarray  # bound on the distance of its points from where l times that brings them, shape (s,) [m]
    travel: np.ndarray  # bound on their distance from where they are in the middle, shape (s,) [m]


class _Move(NamedTuple):
    """Coordinates of a joint that make one move: the joint, its coordinates, whether it turns, and about any axis."""

    joint: int
    rows: np.ndarray
    turns: bool
    any_axis: bool


def bound_chords(case: Case, segments: np.ndarray, *, timed: bool) -> ChordBounds:
    """Bound the motion in segments (s, 2) by control points; if `timed`, l is the share of the segment's time."""
    told = [*pieces(case)]
    starts, spans = (np.array([getattr(one, name) for one in told]) for name in ("start", "span"))
    powers, beside = (np.array([getattr(one, name) for one in told]) for name in ("powers", "beside"))
    degree = powers.shape[1] - 1

    def at(k: np.ndarray, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
        """Control points of the part of a piece between two times (k,), shape (k, degree + 1, n)."""
        s, h = (np.clip(some - starts[k], 0.0, spans[k])[:, None] for some in (begin, end))
        terms = expand_about(powers[k], s) * ((h - s)[:, :, None] ** np.arange(degree + 1)[:, None])
        shares = [[math.comb(i, j) / math.comb(degree, j) for j in range(degree + 1)] for i in range(degree + 1)]
        controls: np.ndarray = np.einsum("ij,kjn->kin", np.array(shares), terms)
        return controls

    def piece_at(t: np.ndarray, side: Literal["left", "right"]) -> np.ndarray:
        found: np.ndarray = np.clip(np.searchsorted(starts, t, side=side) - 1, 0, len(spans) - 1)
        return found

    (begins, ends), middles = segments.T, segments.mean(axis=1)
    first, z = piece_at(begins, "right"), at(piece_at(middles, "right"), middles, middles)[:, 0]
    last = np.maximum(piece_at(ends, "left"), first)  # the one that begins there doesn't count: steps jump
    counts = last - first + 1
    row, of = np.repeat(np.arange(len(segments)), counts), np.cumsum(counts) - counts
    k = np.arange(len(row)) - of[row] + first[row]
    begin, end = np.maximum(begins[row], starts[k]), np.minimum(ends[row], starts[k] + spans[k])
    points = at(k, begin, end)
    chords = points[of + counts - 1, -1] - points[of, 0]
    controls = points - z[row, None]
    if timed:
        times = begin[:, None] + (end - begin)[:, None] * np.arange(degree + 1) / degree
        shares = (times - middles[row, None]) / (ends - begins)[row, None]
    else:
        squares = (chords**2).sum(axis=1)
        shares = np.einsum("rci,ri->rc", controls, chords[row]) / np.where(squares > 0.0, squares, 1.0)[row, None]
    sideways = np.abs(controls - shares[..., None] * chords[row, None]).max(axis=1) + beside[k]
    farthest = np.abs(controls).max(axis=1) + beside[k]
    most = [np.maximum.reduceat(one, of) for one in (np.abs(shares).max(axis=1), farthest, sideways)]
    return ChordBounds(z, chords, *most)


class SegmentBounds:
    """Where bodies are in the middles of segments, and bounds of their motion about that.

    Attributes:
        chords: The motion's columns.
        radii: Of spheres about the robot's bodies and obstacles that move, shape (b,) [m]; else 0.
        centres: Of these spheres, in the segments' middles, shape (s, b, 3) [m, world].
        begins: Rotations (b, 3, 3) and translations (b, 3) of shapes: of the robot's in the frames of their joints, of
            obstacles in the world, where they are at first.
    """

    def __init__(self, case: Case, segments: np.ndarray, middles: Mapping[int, np.ndarray]) -> None:
        """Place and bound everything.

        Args:
            segments: Shape (s, 2) [s, or knots].
            middles: Centres of spheres about some bodies, in the frames of their shapes, shape (3,) [m].
        """
        self._case, self._segments = case, segments
        self._declared: dict[int, Declared] = {}
        self._known: dict[tuple[int, int, bool], BodyBounds] = {}
        self.chords = bound_chords(case, segments, timed=any(body.screw is not None for body in case.bodies))
        self._place_joints()
        self._find_moves()
        self._place_bodies(middles)

    def declared(self, body: int) -> Declared:
        """Return a body as it is declared."""
        return self._declared.setdefault(body, self._declared.get(body) or declared(self._case.bodies[body]))

    def has_end(self, body: int) -> bool:
        """Return whether a body is bounded, no half-space."""
        return bool(self._case.bodies[body].corners.any())

    def poses(self, segment: np.ndarray, body: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return rotations (k, 3, 3) and translations (k, 3) of bodies' shapes (k,) in the middles of segments (k,)."""
        rotations, translations = self.begins[0][body], self.begins[1][body]
        for k in set(body.tolist()):
            if k in self._there:
                own = body == k
                rotations[own], translations[own] = (some[segment[own]] for some in self._there[k])
        return rotations, translations

    def bound(self, body: int, view: int) -> BodyBounds:
        """Bound the motion of one of the robot's bodies relative to a joint; 0 is the world."""
        if (body, view, False) not in self._known:
            self._known[body, view, False] = self._bound(body, view)
        return self._known[body, view, False]

    def bound_mover(self, obstacle: int, body: int) -> BodyBounds:
        """Bound the motion of an obstacle's points; of a half-space's only where a body of the robot is."""
        meets = 0 if self.has_end(obstacle) else body
        if (obstacle, meets, True) not in self._known:
            self._known[obstacle, meets, True] = self._bound_mover(obstacle, body)
        return self._known[obstacle, meets, True]

    def moves(self, obstacle: int) -> bool:
        """Return whether an obstacle moves."""
        return self._case.bodies[obstacle].screw is not None

    def _place_joints(self) -> None:
        case, model = self._case, self._case.model
        data, y, chord = model.createData(), self.chords.z @ case.spread.T + case.offset, self.chords.chords
        count, self._rates = len(y), chord @ case.spread.T
        self._turned, self._shifted = np.empty((count, model.njoints, 3, 3)), np.empty((count, model.njoints, 3))
        columns = np.empty((count, 6, model.nv))
        rows = [slice(joint.idx_v, joint.idx_v + joint.nv) for joint in model.joints]
        several = [i for i in range(1, model.njoints) if model.joints[i].nv > 1]
        used = {body.joint for body in case.bodies} | set(several) | {0}
        for k in range(count):
            q = pin.neutral(model)
            for step in (np.where(case.turning, 0.0, y[k]), case.turned, np.where(case.turning, y[k], 0.0)):
                q = pin.integrate(model, q, step)
            columns[k] = pin.computeJointJacobians(model, data, q).reshape(6, -1)
            for i in used:
                self._turned[k, i], self._shifted[k, i] = data.oMi[i].rotation, data.oMi[i].translation
            for i in several:  # their velocities are in the frame that is turned, and rotation vectors' rates are none
                turns = case.turning[rows[i]]
                first = np.where(turns, case.turned[rows[i]], 0.0)[-3:] if turns.sum() == 3 else np.zeros(3)
                r = y[k, rows[i]][turns] if turns.sum() == 3 else np.array([0.0, 0.0, y[k, rows[i]][-1]])
                turned, rate = pin.exp3(first) @ pin.exp3(r), self._rates[k, rows[i]]
                size = int((~turns).sum())
                slid = turned[:size, :size].T @ rate[~turns]
                spun = pin.Jexp3(r) @ rate[turns] if turns.sum() == 3 else rate[turns]
                self._rates[k, rows[i]] = np.concatenate([slid, spun])
        self._columns = columns.transpose(0, 2, 1)

    def _find_moves(self) -> None:
        """Bound each move of the joints, and find the twist by which it goes along D."""
        case, model, self._moves = self._case, self._case.model, list[_Move]()
        for i in range(1, model.njoints):
            rows = np.arange(model.joints[i].idx_v, model.joints[i].idx_v + model.joints[i].nv)
            turns = case.turning[rows]
            for some in [rows] if len(rows) == 1 else [rows[~turns], rows[turns]]:
                if case.spread[some].any():
                    is_turn = bool(self._columns[0, some, 3:].any())
                    self._moves.append(_Move(i, some, is_turn, is_turn and len(some) == 3))
        size, moves = np.abs(case.spread), self._moves
        x, e = (
            np.array([np.linalg.norm((most @ size.T)[:, m.rows], axis=1) for m in moves]).T
            for most in (self.chords.farthest, self.chords.sideways)
        )
        self._x, self._e = x, e
        self._turns = np.array([float(m.turns) for m in moves])
        self._doubled = np.array([2.0 if m.any_axis else float(m.turns) for m in moves])
        self._sweeps = np.where(self._turns > 0.0, 2.0 * np.sin(0.5 * np.minimum(x, np.pi)), x)
        twists = [np.einsum("skc,sk->sc", self._columns[:, m.rows], self._rates[:, m.rows]) for m in moves]
        self._twists = np.stack(twists, axis=1)

    def _place_bodies(self, middles: Mapping[int, np.ndarray]) -> None:
        case, times = self._case, self._segments.mean(axis=1).tolist()
        first = [one.placement if one.screw is None else one.screw.stops[0] * one.placement for one in case.bodies]
        self.begins = np.array([at.rotation for at in first]), np.array([at.translation for at in first])
        self.centres, self.radii = np.zeros((len(times), len(first), 3)), np.zeros(len(first))
        self._there: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        self._middles: dict[int, np.ndarray] = {}
        for k, body in enumerate(case.bodies):
            if body.screw is not None:
                stands = [_stop(body, now) * body.placement for now in times]
                at = np.array([one.rotation for one in stands]), np.array([one.translation for one in stands])
            elif not body.obstacle:
                turned, shifted = self._turned[:, body.joint], self._shifted[:, body.joint]
                at = turned @ self.begins[0][k], turned @ self.begins[1][k] + shifted
            else:
                continue
            self._there[k] = at
            if self.has_end(k):
                self._middles[k] = middles[k] if k in middles else body.corners.mean(axis=0)
                self.centres[:, k] = at[0] @ self._middles[k] + at[1]
                self.radii[k] = radius_about(self.declared(k), self._middles[k])

    def _path(self, body: int, view: int) -> tuple[list[int], np.ndarray]:
        """Return the moves between a joint and a body, and the sign of each: 1 above the body, -1 above the joint."""
        supports = self._case.model.supports
        to, since = set(supports[self._case.bodies[body].joint]), set(supports[view])
        against = [k for k, move in enumerate(self._moves) if move.joint in since - to][::-1]
        along = [k for k, move in enumerate(self._moves) if move.joint in to - since]
        return against + along, np.array([-1.0] * len(against) + [1.0] * len(along))

    def _bound(self, body: int, view: int) -> BodyBounds:
        path, signs = self._path(body, view)
        c, radius = self.centres[:, body], self.radii[body]
        rho = np.ones((len(c), len(path)))
        for at, k in enumerate(path):
            move = self._moves[k]
            if move.any_axis:
                rho[:, at] = np.linalg.norm(c - self._shifted[:, move.joint], axis=1) + radius
            elif move.turns:
                v, w = np.split(self._columns[:, move.rows[0]], 2, axis=1)
                rho[:, at] = np.linalg.norm(v + _cross(w, c), axis=1) + radius
        x, e, turns = self._x[:, path], self._e[:, path], self._turns[path]
        swept = (rho * self._sweeps[:, path]).sum(axis=1)
        most = rho + swept[:, None] * turns
        before = np.cumsum(x * turns, axis=1) - x * turns
        bent = (rho * e + most * x * (before + 0.5 * self._doubled[path] * x)).sum(axis=1)
        twist = np.einsum("m,smc->sc", signs, self._twists[:, path])
        straight = np.linalg.norm(twist[:, :3] + _cross(twist[:, 3:], c), axis=1)
        straight += np.linalg.norm(twist[:, 3:], axis=1) * radius
        travel = np.minimum((most * x).sum(axis=1), self.chords.shares * straight + bent)
        return BodyBounds(twist, bent, travel)

    def _bound_mover(self, obstacle: int, body: int) -> BodyBounds:
        one, (begin, end), now = self._case.bodies[obstacle], self._segments.T, self._segments.mean(axis=1)
        screw = one.screw
        assert screw is not None, "only what moves is asked for"
        times, has_end = screw.times, self.has_end(obstacle)
        screws = np.array([stop.act(pin.Motion(t)).vector for stop, t in zip(screw.stops, screw.twists, strict=False)])
        if has_end:  # all along a screw its middle is as fast as where that begins
            met = np.array([(stop * one.placement).act(self._middles[obstacle]) for stop in screw.stops[:-1]])[None]
            reach = np.array([[self.radii[obstacle]]])
        else:
            met, reach = self.centres[:, [body]], (self.radii[body] + self.bound(body, 0).travel)[:, None]
        speeds = np.linalg.norm(screws[:, :3] + np.cross(screws[:, 3:], met), axis=2)
        speeds = speeds + np.linalg.norm(screws[:, 3:], axis=1) * reach  # (1 or s, screws)

        def way(since: np.ndarray, until: np.ndarray) -> np.ndarray:
            shared = np.minimum(until[:, None], times[1:]) - np.maximum(since[:, None], times[:-1])
            total: np.ndarray = (np.maximum(shared, 0.0) * speeds).sum(axis=1)
            return total

        travel = np.maximum(way(begin, now), way(now, end))
        k = np.searchsorted(times, begin, side="right") - 1
        on_one = has_end & (k >= 0) & (k < len(screws)) & (end <= times[np.clip(k + 1, 0, len(times) - 1)])
        k = np.clip(k, 0, len(screws) - 1)
        half, turning = 0.5 * (end - begin), np.linalg.norm(screws[k, 3:], axis=1)
        bent = np.where(on_one, 0.5 * turning * speeds[0, k] * half**2, travel)
        return BodyBounds(np.where(on_one[:, None], screws[k] * (end - begin)[:, None], 0.0), bent, travel)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return cross products of rows, shapes (n, 3); NumPy's own takes five times as long."""
    (x, y, z), (u, v, w) = a.T, b.T
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=1)


def _stop(body: Body, now: float) -> pin.SE3:
    assert body.screw is not None, "only what moves is asked for"
    times, stops = body.screw.times, body.screw.stops
    k = min(max(int(np.searchsorted(times, now)) - 1, 0), len(times) - 2)
    return stops[k] * pin.exp6((min(max(now, times[0]), times[-1]) - times[k]) * body.screw.twists[k])
