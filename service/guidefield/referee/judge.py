"""Judge by bisection whether a motion is free, within its limits and constraints, at every time.

A segment of the motion is tested at its middle: there Coal says how far two bodies are apart, and `_reach` bounds how
far their points move within it. Bodies farther apart than that are free; for others both halves are tested. What is
promised is in docs/certificate.md, what stays undecided in docs/referee.md.
"""

from __future__ import annotations

import itertools
import math
import time
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from guidefield.referee.case import (
    Answer,
    Body,
    Case,
    Constraint,
    Finding,
    Piece,
    Verdict,
    beyond_limit,
    expand_about,
    pieces,
)
from guidefield.referee.shapes import distance, distinct, is_closed, winding

# SLACK: Coal's error, so bodies have to be farther apart by it (and 2e-6 more a metre) to be free, and closer by it to
# be too close; constraints, and corners outside of parts, may be off by it. FLOOR: less motion is undecided
SLACK = FLOOR = 1e-6
ROUNDING = 1e-9  # tolerance for a corner to be in a convex part [m]
Judgement = tuple[Answer | None, float, float]  # what is broken; margin above what is required; distance


def judge(case: Case, extra: float = 0.0, own_extra: float = 0.0, seconds: float = math.inf) -> Verdict:
    """Judge a motion.

    Args:
        extra: Distance to keep from obstacles beyond what is required [m].
        own_extra: Distance that the robot's bodies have to keep from each other [m].
        seconds: Time after which the rest is undecided.
    """
    if case.unknown:
        return Verdict(Finding(Answer.NOT_JUDGED, tuple(case.unknown)))
    along = Along(case, extra, own_extra, time.monotonic() + seconds)
    found = false_part(case) or beyond_limit(case) or along.inside() or along.bisect()
    return Verdict(found, along.kept, len(along.pairs), tuple(along.left_out), along.evaluations)


def false_part(case: Case) -> Finding | None:
    """Find a mesh that isn't in its convex parts, by its triangles' corners, or a shell that isn't the mesh closed."""
    for body in case.bodies:
        first, corner = distinct(corners := body.triangles.reshape(-1, 3))
        within, here = np.zeros(len(body.triangles), bool), coal.Transform3s.Identity()
        for part in body.parts:
            gaps = [distance(coal.Sphere(0.0), coal.Transform3s(np.eye(3), p), part, here) for p in corners[first]]
            within |= (np.array(gaps)[corner.reshape(-1, 3)] <= SLACK + ROUNDING).all(axis=1)
        told = [{frozenset(map(tuple, t)) for t in a.tolist() if len(body.shell)} for a in (body.triangles, body.shell)]
        whole = {t for t in told[0] if len(t) == 3} <= told[1] and is_closed(body.shell)
        if (body.parts and not within.all()) or (len(body.shell) and not whole):
            return Finding(Answer.FALSE_PART, (body.name,))
    return None


class Along:
    """Every pair of bodies and every constraint, all along the motion."""

    def __init__(self, case: Case, extra: float, own_extra: float, until: float) -> None:
        self.case, self.until, self.data = case, until, case.model.createData()
        self.kept, self.evaluations, self.left_out = math.inf, 0, list(case.left_out)
        self.carried: list[Body | Constraint] = [*case.bodies, *case.constraints]
        self.corners = np.array([np.c_[one.corners, np.ones(8)].T for one in self.carried])  # (b, 4, 8)
        self.rows = [slice(joint.idx_v, joint.idx_v + joint.nv) for joint in case.model.joints]
        planned = np.array([i > 0 and case.spread[rows].any() for i, rows in enumerate(self.rows)])
        self.moved = planned & [[i in case.model.supports[c.joint] for i in range(len(planned))] for c in self.carried]
        self.pairs: list[tuple[int, int, float]] = []  # two bodies, and the distance that they have to keep
        allowed = {frozenset(pair[:2]) for pair in case.left_out}
        bodies = list(enumerate(case.bodies))
        for (i, a), (j, b) in ((one, other) for one in bodies if not one[1].obstacle for other in bodies[one[0] + 1 :]):
            if b.obstacle and not self.moved[i].any():
                self.left_out.append((a.name, b.name, "the link never moves"))
            elif (self.moved[i] != self.moved[j]).any() and frozenset((a.name, b.name)) not in allowed:
                self.pairs.append((i, j, case.clearance + extra if b.obstacle else own_extra))
        between = [(case.bodies[i].name, case.bodies[j].name) for i, j, _ in self.pairs]
        self.names = [*between, *((one.name,) for one in case.constraints)]

    def inside(self) -> Finding | None:
        """Find a body in another's closed mesh at the start; one that starts outside has to touch it to come inside."""
        first = next(pieces(self.case))
        self._stand(first.powers[0], first.start)
        for k, m in [both for i, j, _ in self.pairs for both in ((i, j), (j, i))]:
            a, b, seen = self.case.bodies[k], self.case.bodies[m], self.placed[k].actInv(self.placed[m])
            points = b.points @ seen.rotation.T + seen.translation
            near = points[((points >= a.corners.min(axis=0)) & (points <= a.corners.max(axis=0))).all(axis=1)]
            shell = a.shell if len(a.shell) else a.triangles
            if len(near) and is_closed(shell) and any(abs(winding(point, shell)) > 0.5 for point in near):
                return Finding(Answer.INSIDE, (a.name, b.name), first.start)
        return None

    def bisect(self) -> Finding:
        """Halve the motion until everything is separated, or something is broken."""
        unsure, n = None, len(self.pairs)
        every = list(range(len(self.names)))
        stack = [(p, low, high, every) for p in pieces(self.case) for low, high in itertools.pairwise(self._cuts(p))]
        stack.reverse()
        while stack:
            piece, low, high, asked = stack.pop()
            start, middle, r = piece.start, 0.5 * (low + high), 0.5 * (high - low)
            if time.monotonic() > self.until:
                return Finding(Answer.UNDECIDED, ("time was up",), start + low)
            z, *terms = expand_about(piece.powers, middle)  # Taylor's
            self._stand(z, start + middle)
            most = piece.beside + sum(np.abs(term) * r**k for k, term in enumerate(terms, 1))
            reached = (*self._reach(most), most)
            always = (*self._reach(piece.beside), piece.beside) if piece.beside.any() else None
            reached[0][:, 0] = [r * self._fastest(k, start + low, start + high) for k in range(len(self.carried))]
            left = []
            for k in asked:
                loss, least = (0.0 if some is None else self._loss(k, *some) for some in (reached, always))
                broken, room, apart = self._pair(k, loss) if k < n else self._constraint(k - n)
                if broken:
                    return Finding(broken, self.names[k], start + middle, apart)
                if room >= loss:
                    self.kept = min(self.kept, room - loss) if k < n else self.kept
                elif room < least > 0.0 or loss - least <= FLOOR:
                    unsure = unsure or Finding(Answer.UNDECIDED, self.names[k], start + middle, apart)
                else:
                    left.append(k)
            stack += [(piece, middle, high, left), (piece, low, middle, left)] if left else []
        return unsure or Finding(Answer.FREE)

    def _cuts(self, piece: Piece) -> list[float]:
        stops = [time - piece.start for one in self.carried if one.screw is not None for time in one.screw.times]
        return sorted({0.0, piece.span, *(float(stop) for stop in stops if 0.0 < stop < piece.span)})

    def _stand(self, z: np.ndarray, now: float) -> None:
        """Place everything where it is with the motion's columns z at a time: joints slide first and turn then."""
        y, q = self.case.spread @ z + self.case.offset, pin.neutral(self.case.model)
        for step in (np.where(self.case.turning, 0.0, y), self.case.turned, np.where(self.case.turning, y, 0.0)):
            q = pin.integrate(self.case.model, q, step)
        pin.computeJointJacobians(self.case.model, self.data, q)
        self.placed = [_place_parent(one, self.data, now) * one.placement for one in self.carried]
        self.coal = [coal.Transform3s(one.rotation, one.translation) for one in self.placed]

    def _reach(self, half: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Bound how far joints move any point of each body, (b, njoints), and how far they turn, (njoints,).

        Let the columns stay within `half` of where they are. Move the joints one by one, from base to tip. While one
        moves, all beyond it still stand: a point p moves by at most e |v + w x p|, with the joint's unit velocity v, w
        and its change e: e times the distance from its axis, or e where it slides. That is convex in p, so largest at a
        corner. A joint of several freedoms slides by a norm, and turns about any axis through its centre by at most the
        norm of its rotation vector's change (the exponential map of rotations stretches nothing). By the triangle
        inequality the distances add up. Joints that move two bodies move both as one.
        """
        y = np.abs(self.case.spread) @ half
        self.points = points = np.array([one.homogeneous[:3] for one in self.placed]) @ self.corners
        moves, turns = np.zeros(self.moved.shape), np.zeros(self.moved.shape[1])
        for i, rows in enumerate(self.rows[1:], 1):
            e, turning = y[rows], self.case.turning[rows]
            if len(e) == 1:
                v, w = np.split(self.data.J.reshape(6, -1)[:, rows], 2)
                turns[i] = e[0] * np.linalg.norm(w)
                moves[:, i] = e[0] * np.linalg.norm(v + np.cross(w, points, axis=-2), axis=1).max(axis=1)
            else:
                turns[i] = np.linalg.norm(e[turning])
                arms = np.linalg.norm(points - self.data.oMi[i].translation[:, None], axis=1).max(axis=1)
                moves[:, i] = np.linalg.norm(e[~turning]) + turns[i] * arms
        return np.where(self.moved, moves, 0.0), turns

    def _fastest(self, k: int, start: float, end: float) -> float:
        """Bound the speed of any point of an obstacle between two times: v + w x p in its frame, all along a screw.

        Of a half-space only points where the robot's corners are count: in its frame these are on the screw.
        """
        one, placed = self.carried[k], self.placed[k]
        if one.screw is None:
            return 0.0
        v, w = np.split(one.screw.twists[(one.screw.times[1:] > start) & (one.screw.times[:-1] < end), None], 2, axis=2)
        points = one.corners @ one.placement.rotation.T + one.placement.translation
        if not one.corners.any():
            points = (self.points[self.moved.any(axis=1)].swapaxes(1, 2) - placed.translation) @ placed.rotation
        return float(np.linalg.norm(v + np.cross(w, points.reshape(-1, 3)), axis=2).max(initial=0.0))

    def _loss(self, k: int, moves: np.ndarray, turns: np.ndarray, half: np.ndarray) -> float:
        """Bound how much closer a pair's bodies get as joints move, or how much a constraint's value grows."""
        if k < len(self.pairs):
            i, j, _ = self.pairs[k]
            return float((moves[i] + moves[j])[self.moved[i] ^ self.moved[j]].sum() + moves[i, 0] + moves[j, 0])
        k -= len(self.pairs)
        index = len(self.case.bodies) + k
        some = moves[index] if len(self.case.constraints[k].across) else turns
        whole = float(some[self.moved[index]].sum())
        return min(whole, self._across(k, half, whole))

    def _across(self, k: int, half: np.ndarray, whole: float) -> float:
        """Bound how much a constraint's value grows, by the share of each joint's motion that counts, to second order.

        As joint j moves, the velocity by joint i changes by at most e_j times the distance of the later of both from
        the frame, which is no more than here plus the `whole` motion; an axis' direction changes by at most e_j.
        """
        one, index = self.case.constraints[k], len(self.case.bodies) + k
        rows = [self.rows[i] for i in np.flatnonzero(self.moved[index])]
        if any(row.stop - row.start > 1 for row in rows):
            return math.inf
        numbers = [row.start for row in rows]
        e, placed = (np.abs(self.case.spread) @ half)[numbers], self.placed[index]
        v, w = np.split(self.data.J.reshape(6, -1)[:, numbers].T, 2, axis=1)
        if not len(one.across):
            axis, turns = placed.rotation @ one.axis, float(e @ np.linalg.norm(w, axis=1))
            return float(e @ np.linalg.norm(np.cross(w, axis), axis=1)) + 0.5 * turns**2
        ways, order = v + np.cross(w, placed.translation), np.arange(len(e))
        arms = np.where(w.any(axis=1), np.linalg.norm(ways, axis=1) + whole, 1.0)
        bent = 0.5 * float(e @ arms[np.maximum.outer(order, order)] @ e)
        return float(e @ np.linalg.norm(ways @ one.across.T, axis=1)) + bent

    def _pair(self, k: int, loss: float) -> Judgement:
        """Test two bodies: first the parts that contain them, less what may stand out of these; then as declared."""
        i, j, required = self.pairs[k]
        a, b = self.case.bodies[i], self.case.bodies[j]
        for some, others, out in ((a.parts or [a.exact], b.parts or [b.exact], SLACK), ([a.exact], [b.exact], 0.0)):
            self.evaluations += len(some) * len(others)
            gap = min(distance(one, self.coal[i], other, self.coal[j]) for one in some for other in others)
            apart = gap - a.rounding - b.rounding - out
            if (room := apart - SLACK * (1.0 + 2.0 * abs(apart)) - required) >= loss:
                break
        close = Answer.TOO_CLOSE if apart <= required - SLACK else None
        return Answer.CONTACT if apart <= 0.0 else close, room, apart

    def _constraint(self, k: int) -> Judgement:
        """Test the angle of a frame's axis, or the distance of its origin, by how much it exceeds the limit."""
        one, index = self.case.constraints[k], len(self.case.bodies) + k
        axis, off = self.placed[index].rotation @ one.axis, self.placed[index].translation - one.point
        angle = math.atan2(float(np.linalg.norm(np.cross(axis, one.target))), float(axis @ one.target))
        excess = angle + float(np.linalg.norm(one.across @ off)) - one.limit  # one of both is 0
        return Answer.CONSTRAINT_BROKEN if excess > SLACK else None, SLACK - excess, excess


def _place_parent(one: Body | Constraint, data: Any, now: float) -> Any:
    """Place the joint that carries a body or frame; or an obstacle's own frame, on a screw from stop to stop."""
    if one.screw is None:
        return data.oMi[one.joint]
    times, stops = one.screw.times, one.screw.stops
    k = min(max(int(np.searchsorted(times, now)) - 1, 0), len(times) - 2)
    return stops[k] * pin.exp6((min(max(now, times[0]), times[-1]) - times[k]) * one.screw.twists[k])
