"""The certificate: Coal's judgement of a whole motion, between its samples too.

A motion is a chain of Bezier curves in the group's chart. A curve lies in the box of its control points, and near the
straight way from its first to its last. If Coal says that at the box's middle a pair keeps more than it can lose in the
box (`MotionBound`), or near the way (`Closing.beside`), it is free all along the curve; else the curve is divided, for
the pairs that are left, down to a floor. Balls and boxes about bodies tell most pairs apart before Coal is asked.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import chain, islice
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from guidefield.collision.certify.chords import chords_of
from guidefield.collision.certify.curve_segments import CurveSegment, curve_segments
from guidefield.collision.certify.position_limits import excesses
from guidefield.collision.certify.settings import CERTIFICATE, LIMITS, with_coal_error
from guidefield.collision.certify.verdict import Reason, Verdict
from guidefield.collision.closing import Ways
from guidefield.collision.world import World
from guidefield.robot.group.tangents import tangents
from guidefield.robot.model.configuration import LimitFault
from guidefield.robot.model.spaces import ChartCurves, ChartPoint, ChartPoints


def certify(
    world: World,
    pieces: ChartCurves,
    min_clearance: float = 0.0,
    floor: float = CERTIFICATE.floor,
    stopped: Callable[[], object] = lambda: None,
) -> Verdict:
    """Judge a motion.

    `CERTIFICATE.at_once` parts are judged coarsely before any of them is judged finely; what comes after a refusal is
    not looked at any more, so that everything before the refusal that is told is certified. Whether the robot is wholly
    inside a closed mesh at the start is another question: `enclosed`. Of a piece on which a joint leaves its limits by
    more than `LIMITS.tolerance` nothing is certified, only what comes before it.

    Args:
        world: The robot among obstacles.
        pieces: Bezier control points of each piece in the group's chart, shape (m, k, nv) [rad or m]; any degree k - 1.
        min_clearance: What robot and obstacles must keep apart [m]; the robot and itself must only not touch.
        floor: A pair whose possible motion [m] is down to this and which still can't be told apart is undecided.
        stopped: Asked now and then; anything true ends the judgement.

    Raises:
        ValueError: if a control point is not finite.
    """
    judge = _Judge(world, min_clearance, floor)
    pieces = np.asarray(pieces, float)
    if not np.isfinite(pieces).all():
        raise ValueError("control points have to be finite")
    beyond = _beyond_limits(world, pieces)
    segments = curve_segments(pieces if beyond is None else pieces[: beyond.piece])
    while level := list(islice(segments, CERTIFICATE.at_once)):
        refusal = judge.refusal(level, stopped)
        if refusal is not None:
            return refusal
    return Verdict(Reason.FREE, judge.evaluations) if beyond is None else replace(beyond, evaluations=judge.evaluations)


def motion_free(
    world: World, z0: ChartPoint, z1: ChartPoint, min_clearance: float = 0.0, floor: float = CERTIFICATE.floor
) -> Verdict:
    """Judge the straight motion between two points, each of shape (nv,), of the group's chart; see `certify`."""
    return certify(world, np.array([[z0, z1]]), min_clearance, floor)


def _beyond_limits(world: World, pieces: ChartCurves) -> Verdict | None:
    """The refusal of the first piece on which a joint leaves its limits, where it is farthest beyond; None if none."""
    group = world.group
    found, places = excesses(pieces, group.lower, group.upper)
    refused = np.flatnonzero((found > LIMITS.tolerance).any(axis=1))
    if not len(refused):
        return None
    piece = int(refused[0])
    at = int(np.argmax(found[piece]))
    parameter = float(places[piece, at])
    z = _point(pieces[piece], parameter)
    joint = next(joint for joint in group.joints if joint.idx_v <= at < joint.idx_v + joint.nv)
    fault = LimitFault(joint.name, float(z[at]), float(group.lower[at]), float(group.upper[at]))
    return Verdict(Reason.BEYOND_LIMITS, 0, piece, parameter, (piece, 0.0), None, z, fault)


def _point(controls: ChartPoints, parameter: float) -> ChartPoint:
    """The point (nv,) of a Bezier curve, control points (k, nv), at a parameter: de Casteljau's scheme."""
    row = controls
    while len(row) > 1:
        row = row[:-1] + parameter * (row[1:] - row[:-1])
    point: ChartPoint = row[0]
    return point


def _place(segment: CurveSegment) -> tuple[int, float]:
    """Where a segment begins along the motion."""
    return segment.piece, segment.start


def _unfinished(world: World, first: CurveSegment, evaluations: int) -> Verdict:
    """The verdict of a judgement that was stopped, the first segment that is left in it."""
    pair = world.pair_names(first.pairs[0]) if first.pairs else None
    at = first.start
    return Verdict(Reason.STOPPED, evaluations, first.piece, at, (first.piece, at), pair, first.controls[0, 0])


class _Judge:
    """One judgement: what is asked for, and how many configurations were judged."""

    def __init__(self, world: World, min_clearance: float, floor: float) -> None:
        self.world = world
        self.floor = floor
        self.evaluations = 0
        self.min_clearance = min_clearance

    def refusal(self, level: list[CurveSegment], stopped: Callable[[], object]) -> Verdict | None:
        """Why one of some segments in order is refused, the first of them; None if all are free."""
        refusal: Verdict | None = None
        while level:
            finer: list[CurveSegment] = []
            for first in range(0, len(level), CERTIFICATE.batch):
                if stopped():
                    return _unfinished(self.world, min([*finer, level[first]], key=_place), self.evaluations)
                parts, found = self.divided(level[first : first + CERTIFICATE.batch])
                finer += parts
                if found is not None:
                    refusal = found
                    break
            level = finer
        return None if refusal is None else replace(refusal, evaluations=self.evaluations)

    def divided(self, level: Sequence[CurveSegment]) -> tuple[list[CurveSegment], Verdict | None]:
        """Judge some segments in order, up to the first that is refused.

        Returns:
            The parts of those that can't be told yet; why the last one that was looked at is refused, or None.
        """
        finer: list[CurveSegment] = []
        bodies, near = self._near(level)
        for segment, placements, asked in zip(level, bodies, near, strict=True):
            left = self._left(placements, asked) if asked else []
            if not left:
                continue
            share = _decided_share(left)
            pairs = [one.pair for one in left] if 2 * len(left) < len(self.world.pairs) else None
            parts = segment.parts(math.ceil(1.0 / share), pairs)
            if share == CERTIFICATE.least_share or min(one.bound for one in left) <= CERTIFICATE.mesh_from:
                refusal = self._refusal_at(parts[len(parts) // 2], segment, left)
                if refusal is not None:
                    return finer, refusal
            finer += parts
        return finer, None

    def _near(self, level: Sequence[CurveSegment]) -> tuple[np.ndarray, list[list[_Asked]]]:
        """At each segment's middle: where the robot's bodies stand, (s, r, 3, 4), and the pairs Coal has to judge."""
        world, group = self.world, self.world.group
        self.evaluations += len(level)
        chords = chords_of([segment.controls for segment in level])
        jacobians = np.empty((len(level), 6, world.model.nv))
        joints, joints_now = np.empty((len(level), world.model.njoints, 3, 4)), world.joint_placements
        bodies, bodies_now = np.empty((len(level), *world.body_placements.shape)), world.body_placements
        for row, middle in enumerate(chords.middles):
            jacobian = pin.computeJointJacobians(world.model, world.data, group.expand_from_chart(middle))
            jacobians[row] = jacobian.reshape(6, -1)  # of a single joint Pinocchio hands out a vector
            world.place_bodies()
            joints[row], bodies[row] = joints_now, bodies_now
        centres = world.bodies.centres_in_world(joints)
        reach = world.motion_bound.reach(jacobians, centres)
        own, mixed = world.motion_bound.moved(reach, chords.half_widths)
        fresh = np.flatnonzero([segment.pairs is None for segment in level])
        margins = with_coal_error(own[fresh]), with_coal_error(mixed[fresh] + self.min_clearance)
        at, pairs, apart = world.near_pairs.within(joints[fresh], centres[fresh], *margins)
        near = _with_pairs_left(level, _Near(fresh[at], pairs, apart))
        moves = tangents(group, chords.middles, chords.chords) @ group.expand_velocity.T
        ways = Ways(jacobians, centres, reach, chords.chords, moves, chords.off)
        return bodies, self._with_margins(near, own, mixed, ways, joints)

    def _with_margins(
        self, near: _Near, own: np.ndarray, mixed: np.ndarray, ways: Ways, joints: np.ndarray
    ) -> list[list[_Asked]]:
        """Pairs at each of s segments that balls can't tell apart, with what they may lose and have to keep.

        Args:
            near: The pairs.
            own: How much closer own pairs can come in the segment's box, shape (s, n_self) [m].
            mixed: How much closer the robot's bodies can come there to what stands still, shape (s, r) [m].
            ways: The straight ways that the segments are near.
            joints: Placements of the joints at the middles, shape (s, njoints, 3, 4) [m].
        """
        world, (row, pair, apart) = self.world, near
        first, second = world.pairs.bodies(pair).T
        is_own, bound = pair < world.pairs.n_self, mixed[row, first]
        bound[is_own] = own[row[is_own], pair[is_own]]
        bound = np.minimum(bound, world.closing.beside(ways, row, np.where(is_own, world.pairs.links + pair, first)))
        kept = np.where(is_own, 0.0, self.min_clearance)
        margins = with_coal_error(bound + kept)
        unknown = np.flatnonzero(np.isneginf(apart))
        apart[unknown] = world.near_pairs.bounds(joints, ways.centres, row[unknown], pair[unknown], margins[unknown])
        close = np.flatnonzero(apart <= margins)
        columns = (column[close].tolist() for column in (pair, first, second, bound, kept, margins))
        asked = zip(*columns, strict=True)
        return [list(islice(asked, count)) for count in np.bincount(row[close], minlength=len(joints)).tolist()]

    def _left(self, placements: np.ndarray, asked: Sequence[_Asked]) -> list[_Left]:
        """Those of some pairs that are within their margins, the robot's bodies where they are told, (r, 3, 4).

        Hulls are asked first, the meshes in them only where that does not tell.
        """
        world, left = self.world, []
        world.put_bodies(placements)
        for pair, first, second, bound, kept, margin in asked:
            apart = world.penetration_of(first, second, margin, by_hulls=True)
            if apart is None:
                continue
            meshes = bound <= CERTIFICATE.mesh_from and world.is_hulled(pair)
            if not (meshes and world.penetration_of(first, second, margin) is None):
                left.append(_Left(pair, bound, kept, apart))
        return left

    def _refusal_at(self, rest: CurveSegment, segment: CurveSegment, left: list[_Left]) -> Verdict | None:
        """Why a segment is refused where its rest begins: it touches there, or the pairs left can't move any less."""
        z = rest.controls[0, 0]
        found = self._touching(z, left)
        if found is None:
            undecided = [one.pair for one in left if one.bound <= self.floor]
            if not undecided:
                return None
            found = Reason.UNDECIDED, undecided[0]
        names = self.world.pair_names(found[1])
        return Verdict(found[0], self.evaluations, rest.piece, rest.start, (segment.piece, segment.start), names, z)

    def _touching(self, z: ChartPoint, left: list[_Left]) -> tuple[Reason, int] | None:
        """What is wrong at a point (nv,) of the curve, contact or too close, and with which of some pairs; or None."""
        world, group = self.world, self.world.group
        self.evaluations += 1
        world.place(group.expand_from_chart(z))
        for one in left:
            if world.penetration(one.pair) is not None:
                return Reason.CONTACT, one.pair
        for one in left:
            if one.kept > 0.0 and world.penetration(one.pair, one.kept) is not None:
                return Reason.TOO_CLOSE, one.pair
        return None


class _Near(NamedTuple):
    """Pairs that may be near each other in segments, by segment.

    Attributes:
        row: Index of the segment, shape (k,).
        pair: Index of the pair, shape (k,).
        apart: A lower bound of its signed distance at the segment's middle, shape (k,) [m]; minus infinity: unknown.
    """

    row: np.ndarray
    pair: np.ndarray
    apart: np.ndarray


def _with_pairs_left(level: Sequence[CurveSegment], fresh: _Near) -> _Near:
    """The pairs in segments of which none was judged before, and those that are left in the others."""
    left = [segment.pairs or [] for segment in level]
    counts = [len(some) for some in left]
    count = sum(counts)
    if not count:
        return fresh
    row = np.concatenate([fresh.row, np.repeat(np.arange(len(left)), counts)])
    pair = np.concatenate([fresh.pair, np.fromiter(chain.from_iterable(left), int, count)])
    order = np.argsort(row, kind="stable")
    return _Near(row[order], pair[order], np.concatenate([fresh.apart, np.full(count, -np.inf)])[order])


_Asked = tuple[int, int, int, float, float, float]
"""A pair and its bodies; how much closer it can come within a segment, what it has to keep, what to ask Coal [m]."""


class _Left(NamedTuple):
    """A pair that is within its margin at a segment's middle.

    Attributes:
        pair: Its index.
        bound: How much closer it can come within the segment [m].
        kept: What it has to keep [m].
        apart: How far apart it is [m].
    """

    pair: int
    bound: float
    kept: float
    apart: float


def _decided_share(left: Sequence[_Left]) -> float:
    """Of how large a share of a segment the pairs left would likely be told apart, by how far apart they are."""
    share = min([0.5, *((one.apart - one.kept) / one.bound for one in left if one.bound > 0.0)])
    return max(share, CERTIFICATE.least_share)
