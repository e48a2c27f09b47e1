"""The certificate: Coal's judgement of a whole motion, between its samples too.

A motion is a chain of Bezier curves in the group's chart. A curve lies in the box of its control points. If Coal says
that at the box's middle a pair keeps more than it can lose within the box (`MotionBound`), it is free all along the
curve; else the curve is divided, for the pairs that are left, down to a floor. Balls and boxes about bodies tell most
pairs apart before Coal is asked.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from guidefield.collision.certify.curve_segments import CurveSegment, curve_segments
from guidefield.collision.certify.position_limits import excesses
from guidefield.collision.certify.settings import CERTIFICATE, LIMITS, with_coal_error
from guidefield.collision.certify.verdict import Reason, Verdict
from guidefield.collision.world import World
from guidefield.robot.model.configuration import LimitFault
from guidefield.robot.model.spaces import ChartCurves, ChartPoint, ChartPoints, ModelConfiguration


def certify(
    world: World,
    pieces: ChartCurves,
    min_clearance: float = 0.0,
    floor: float = CERTIFICATE.floor,
    stopped: Callable[[], object] = lambda: None,
) -> Verdict:
    """Judge a motion.

    All parts are judged coarsely before any is judged finely; what comes after a refusal is not looked at any more, so
    that everything before the refusal that is told is certified. Whether the robot is wholly inside a closed mesh at
    the start is another question: `enclosed`. Of a piece on which a joint leaves its limits by more than
    `LIMITS.tolerance` nothing is certified, only what comes before it.

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
    refusal = _beyond_limits(world, pieces)
    level = curve_segments(pieces if refusal is None else pieces[: refusal.piece])
    while level:
        finer: list[CurveSegment] = []
        for first in range(0, len(level), CERTIFICATE.batch):
            if stopped():
                return _unfinished(world, min([*finer, level[first]], key=_place), judge.evaluations)
            parts, found = judge.divided(level[first : first + CERTIFICATE.batch])
            finer += parts
            if found is not None:
                refusal = found
                break
        level = finer
    if refusal is not None:
        return replace(refusal, evaluations=judge.evaluations)
    return Verdict(Reason.FREE, judge.evaluations)


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
        self._kept = np.where(world.is_obstacle_pair, min_clearance, 0.0)
        self._hulled = world.hulled.tolist()
        self._together = max(1, CERTIFICATE.most_pairs // max(1, len(world.pairs)))

    def divided(self, level: Sequence[CurveSegment]) -> tuple[list[CurveSegment], Verdict | None]:
        """Judge some segments in order, up to the first that is refused.

        Returns:
            The parts of those that can't be told yet; why the last one that was looked at is refused, or None.
        """
        qs, bounds, near = self._measured(level)
        finer: list[CurveSegment] = []
        for segment, q, bound, pairs in zip(level, qs, bounds, near, strict=True):
            left = self._left(q, bound, pairs) if pairs else []
            if not left:
                continue
            share = self._decided_share(left, bound)
            parts = segment.parts(math.ceil(1.0 / share), left if 2 * len(left) < len(self._kept) else None)
            if share == CERTIFICATE.least_share or bound[left].min() <= CERTIFICATE.mesh_from:
                refusal = self._refusal_at(parts[len(parts) // 2], segment, left, bound)
                if refusal is not None:
                    return finer, refusal
            finer += parts
        return finer, None

    def _decided_share(self, left: list[int], bounds: np.ndarray) -> float:
        """Of how large a share of a segment the pairs left would likely be told apart, by Coal's last answers."""
        share, keep = 0.5, self._kept + self.world.roundings
        for pair in left:
            result = self.world.hull_margin_data.collisionResults[pair]
            apart = result.getContact(0).penetration_depth - keep[pair]
            share = min(share, apart / bounds[pair]) if bounds[pair] > 0.0 else share
        return max(share, CERTIFICATE.least_share)

    def _measured(self, level: Sequence[CurveSegment]) -> tuple[list[ModelConfiguration], np.ndarray, list[list[int]]]:
        """At each segment's middle: configuration, bounds (s, n) within the box, and which pairs Coal has to judge."""
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
        bounds = world.motion_bound.at(jacobians, centres, 0.5 * (high - low))
        asked = [[] if segment.pairs is None else segment.pairs for segment in level]
        fresh = np.flatnonzero([segment.pairs is None for segment in level])
        for first in range(0, len(fresh), self._together):
            rows = fresh[first : first + self._together]
            near = self._near(placements[rows], centres[rows], bounds[rows])
            for row, pairs in zip(rows.tolist(), near, strict=True):
                asked[row] = pairs
        return qs, bounds, asked

    def _near(self, placements: np.ndarray, centres: np.ndarray, bounds: np.ndarray) -> list[list[int]]:
        """The pairs at each of s configurations that balls and boxes about them can't tell apart."""
        world = self.world
        margins = with_coal_error(bounds + self._kept)
        near = world.bodies.separations(centres, world.pairs, world.n_self) <= margins
        rows, pairs = np.nonzero(near)
        apart = world.bodies.closer_separations(placements, rows, world.pairs[pairs], world.is_obstacle_pair[pairs])
        close = apart <= margins[rows, pairs]
        found: list[list[int]] = [[] for _ in bounds]
        for row, pair in zip(rows[close].tolist(), pairs[close].tolist(), strict=True):
            found[row].append(pair)
        return found

    def _left(self, q: ModelConfiguration, bounds: np.ndarray, pairs: list[int]) -> list[int]:
        """Those of some pairs that are within their bounds (n,), and what they have to keep, at a configuration.

        Hulls are asked first, the meshes in them only where that does not tell.
        """
        world = self.world
        margins = with_coal_error(bounds + self._kept)
        world.set_margins(world.hulls, world.hull_margin_data, margins)
        pin.updateGeometryPlacements(world.model, world.data, world.hulls, world.hull_margin_data, q)
        left = [pair for pair in pairs if pin.computeCollision(world.hulls, world.hull_margin_data, pair)]
        asked = [pair for pair in left if self._hulled[pair] and bounds[pair] <= CERTIFICATE.mesh_from]
        if not asked:
            return left
        world.set_margins(world.geometry, world.margin_data, margins)
        pin.updateGeometryPlacements(world.model, world.data, world.geometry, world.margin_data, q)
        free = {pair for pair in asked if not pin.computeCollision(world.geometry, world.margin_data, pair)}
        return [pair for pair in left if pair not in free]

    def _refusal_at(
        self, rest: CurveSegment, segment: CurveSegment, left: list[int], bounds: np.ndarray
    ) -> Verdict | None:
        """Why a segment is refused where its rest begins: it touches there, or the pairs left can't move any less."""
        z = rest.controls[0, 0]
        found = self._touching(z, left)
        if found is None:
            undecided = [pair for pair in left if bounds[pair] <= self.floor]
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
        pin.updateGeometryPlacements(world.model, world.data, world.geometry, world.geometry_data, q)
        for pair in pairs:
            if pin.computeCollision(world.geometry, world.geometry_data, pair):
                return Reason.CONTACT, pair
        wanting = [pair for pair in pairs if self._kept[pair] > 0.0]
        if wanting:
            world.set_margins(world.geometry, world.margin_data, self._kept)
            pin.updateGeometryPlacements(world.model, world.data, world.geometry, world.margin_data, q)
        for pair in wanting:
            if pin.computeCollision(world.geometry, world.margin_data, pair):
                return Reason.TOO_CLOSE, pair
        return None
