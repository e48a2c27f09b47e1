"""The certificate: Coal's judgement of a whole motion, between its samples too.

A motion is a chain of Bezier curves in the group's chart. A curve lies in the box of its control points. If Coal says
that at the box's middle a pair keeps more than it can lose within the box (`MotionBound`), it is free all along the
curve; else the curve is divided, for the pairs that are left, down to a floor. Balls and boxes about bodies tell most
pairs apart before Coal is asked.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import islice

import numpy as np
import pinocchio as pin

from guidefield.collision.certify.curve_segments import CurveSegment, curve_segments
from guidefield.collision.certify.position_limits import excesses
from guidefield.collision.certify.settings import CERTIFICATE, LIMITS, with_coal_error
from guidefield.collision.certify.verdict import Reason, Verdict
from guidefield.collision.world import World
from guidefield.robot.model.configuration import LimitFault
from guidefield.robot.model.spaces import ChartCurves, ChartPoint, ChartPoints, ModelConfiguration

Bound = Callable[[int], float]
"""How much closer a pair can come within a segment [m], by its index."""


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
        qs, bounds, near = self._measured(level)
        finer: list[CurveSegment] = []
        for segment, q, bound, pairs in zip(level, qs, bounds, near, strict=True):
            left = self._left(q, bound, pairs) if pairs else {}
            if not left:
                continue
            share = self._decided_share(left, bound)
            parts = segment.parts(math.ceil(1.0 / share), list(left) if 2 * len(left) < len(self.world.pairs) else None)
            if share == CERTIFICATE.least_share or min(map(bound, left)) <= CERTIFICATE.mesh_from:
                refusal = self._refusal_at(parts[len(parts) // 2], segment, list(left), bound)
                if refusal is not None:
                    return finer, refusal
            finer += parts
        return finer, None

    def _kept(self, pair: int) -> float:
        """What a pair has to keep [m]."""
        return 0.0 if pair < self.world.pairs.n_self else self.min_clearance

    def _decided_share(self, left: Mapping[int, float], bound: Bound) -> float:
        """Of how large a share of a segment the pairs left would likely be told apart, by how far apart they are."""
        share = 0.5
        for pair, apart in left.items():
            share = min(share, (apart - self._kept(pair)) / bound(pair)) if bound(pair) > 0.0 else share
        return max(share, CERTIFICATE.least_share)

    def _measured(self, level: Sequence[CurveSegment]) -> tuple[list[ModelConfiguration], list[Bound], list[list[int]]]:
        """At each segment's middle: configuration, the pairs' bounds in the box, and which pairs Coal has to judge."""
        world, group = self.world, self.world.group
        self.evaluations += len(level)
        low, high = np.array([segment.low for segment in level]), np.array([segment.high for segment in level])
        qs = [group.expand_from_chart(middle) for middle in 0.5 * (low + high)]
        jacobians = np.empty((len(qs), 6, world.model.nv))
        placements, there = np.empty((len(qs), world.model.njoints, 3, 4)), world.joint_placements
        for row, q in enumerate(qs):
            jacobian = pin.computeJointJacobians(world.model, world.data, q)
            jacobians[row] = jacobian.reshape(6, -1)  # of a single joint Pinocchio hands out a vector
            placements[row] = there
        centres = world.bodies.centres_in_world(placements)
        own, mixed = world.motion_bound.at(jacobians, centres, 0.5 * (high - low))
        asked = [[] if segment.pairs is None else segment.pairs for segment in level]
        fresh = np.flatnonzero([segment.pairs is None for segment in level])
        margins = with_coal_error(own[fresh]), with_coal_error(mixed[fresh] + self.min_clearance)
        near = world.near_pairs.within(placements[fresh], centres[fresh], *margins)
        for row, pair in zip(fresh[near[0]].tolist(), near[1].tolist(), strict=True):
            asked[row].append(pair)
        return qs, [self._bound(*bounds) for bounds in zip(own, mixed, strict=True)], asked

    def _bound(self, own: np.ndarray, mixed: np.ndarray) -> Bound:
        """How much closer a pair can come, of bounds of own pairs (n_self,) and of bodies that move (r,) [m]."""
        pairs, count = self.world.pairs, self.world.pairs.n_self
        return lambda pair: float(own[pair] if pair < count else mixed[pairs.of(pair)[0]])

    def _left(self, q: ModelConfiguration, bound: Bound, pairs: list[int]) -> dict[int, float]:
        """Those of some pairs that are within their bounds, and what they have to keep; how far apart each is [m].

        Hulls are asked first, the meshes in them only where that does not tell.
        """
        world, left = self.world, {}
        world.place(q)
        for pair in pairs:
            margin = with_coal_error(bound(pair) + self._kept(pair))
            apart = world.penetration(pair, margin, by_hulls=True)
            meshes = apart is not None and bound(pair) <= CERTIFICATE.mesh_from and world.is_hulled(pair)
            if apart is not None and not (meshes and world.penetration(pair, margin) is None):
                left[pair] = apart
        return left

    def _refusal_at(self, rest: CurveSegment, segment: CurveSegment, left: list[int], bound: Bound) -> Verdict | None:
        """Why a segment is refused where its rest begins: it touches there, or the pairs left can't move any less."""
        z = rest.controls[0, 0]
        found = self._touching(z, left)
        if found is None:
            undecided = [pair for pair in left if bound(pair) <= self.floor]
            if not undecided:
                return None
            found = Reason.UNDECIDED, undecided[0]
        names = self.world.pair_names(found[1])
        return Verdict(found[0], self.evaluations, rest.piece, rest.start, (segment.piece, segment.start), names, z)

    def _touching(self, z: ChartPoint, pairs: list[int]) -> tuple[Reason, int] | None:
        """What is wrong at a point (nv,) of the curve, contact or too close, and with which of some pairs; or None."""
        world, group = self.world, self.world.group
        self.evaluations += 1
        q = group.expand_from_chart(z)
        world.place(q)
        for pair in pairs:
            if world.penetration(pair) is not None:
                return Reason.CONTACT, pair
        for pair in pairs:
            if self._kept(pair) > 0.0 and world.penetration(pair, self._kept(pair)) is not None:
                return Reason.TOO_CLOSE, pair
        return None
