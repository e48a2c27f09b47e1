"""The certificate: Coal's judgement of a whole motion, between its samples too.

A motion is a chain of Bezier curves in the group's chart. A curve lies in the box of its control points, and near the
straight way from its first to its last. If Coal says that at the box's middle a pair keeps more than it can lose in the
box (`MotionBound`), or near the way (`Closing.beside`), it is free all along the curve; else the curve is divided, for
the pairs that are left, down to a floor. Balls, boxes and slabs tell most pairs apart before Coal is asked.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import accumulate, islice
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from guidefield.collision.world import World
from guidefield.deadline import UNLIMITED, Deadline
from guidefield.kernels.certificate.asked import TOLD, find_asked
from guidefield.kernels.certificate.near import ASKED
from guidefield.prove.certified_tables import certified_obstacles, certified_robot
from guidefield.prove.chords import Chords, chords_of
from guidefield.prove.curve_segments import CurveSegment, curve_segments, places_ahead, point_on
from guidefield.prove.position_limits import excesses
from guidefield.prove.settings import CERTIFICATE, LIMITS
from guidefield.prove.verdict import Reason, Verdict
from guidefield.robot.group.tangents import tangents
from guidefield.robot.model.configuration import LimitFault
from guidefield.robot.model.spaces import ChartCurves, ChartPoint, ModelTangents

ROOM = 1024
"""Room for so many pairs that are near each other in the segments of a batch; where there are more, they are found
again."""


def certify(
    world: World,
    pieces: ChartCurves,
    min_clearance: float = 0.0,
    floor: float = CERTIFICATE.floor,
    deadline: Deadline = UNLIMITED,
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
        deadline: Ends the judgement.

    Raises:
        ValueError: if a control point is not finite.
    """
    pieces = np.asarray(pieces, float)
    if not np.isfinite(pieces).all():
        raise ValueError("control points have to be finite")
    judge = _Judge(world, pieces, min_clearance, floor)
    if world.held_contacts and len(pieces):
        begin: ChartPoint = pieces[0, 0]
        return Verdict(Reason.CONTACT, 1, 0, 0.0, (0, 0.0), world.held_contacts[0].pair, begin)
    beyond = _beyond_limits(world, pieces)
    segments = curve_segments(pieces if beyond is None else pieces[: beyond.piece])
    while level := list(islice(segments, CERTIFICATE.at_once)):
        refusal = judge.refusal(level, deadline)
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
    z = point_on(pieces[piece], parameter)
    joint = next(joint for joint in group.joints if joint.idx_v <= at < joint.idx_v + joint.nv)
    fault = LimitFault(joint.name, float(z[at]), float(group.lower[at]), float(group.upper[at]))
    return Verdict(Reason.BEYOND_LIMITS, 0, piece, parameter, (piece, 0.0), None, z, fault)


def _place(segment: CurveSegment) -> tuple[int, float]:
    """Where a segment begins along the motion."""
    return segment.piece, segment.start


def _unfinished(world: World, first: CurveSegment, evaluations: int) -> Verdict:
    """The verdict of a judgement that was stopped, the first segment that is left in it."""
    pair = None if first.pairs is None else world.pair_names(int(first.pairs[0, 0]))
    at = first.start
    return Verdict(Reason.STOPPED, evaluations, first.piece, at, (first.piece, at), pair, first.controls[0, 0])


class _Judge:
    """One judgement: what is asked for, and how many configurations were judged."""

    def __init__(self, world: World, pieces: ChartCurves, min_clearance: float, floor: float) -> None:
        self.world = world
        self.pieces = pieces
        self.floor = floor
        self.evaluations = 0
        self.min_clearance = min_clearance
        self._robot, self._obstacles = certified_robot(world), certified_obstacles(world)

    def refusal(self, level: list[CurveSegment], deadline: Deadline) -> Verdict | None:
        """Why one of some segments in order is refused, the first of them; None if all are free."""
        refusal: Verdict | None = None
        while level:
            finer: list[CurveSegment] = []
            for first in range(0, len(level), CERTIFICATE.batch):
                if deadline.expired():
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
        joints, near = self._near(level)
        for row, asked in near.items():
            segment, left = level[row], self._left(joints[row], asked)
            if not left:
                continue
            share = _decided_share(left)
            few = 2 * len(left) < len(self.world.pairs)
            pairs = np.array([(one.pair, one.first, one.second) for one in left], np.int64) if few else None
            parts = segment.parts(math.ceil(1.0 / share), pairs)
            if share == CERTIFICATE.least_share or any(one.bound <= one.asked_from(self.floor) for one in left):
                refusal = self._refusal_at(parts[len(parts) // 2], segment, left)
                if refusal is not None:
                    return finer, refusal
            finer += parts
        return finer, None

    def _near(self, level: Sequence[CurveSegment]) -> tuple[np.ndarray, dict[int, list[_Asked]]]:
        """At each segment's middle: where the joints stand, (s, njoints, 3, 4), and the pairs Coal has to judge."""
        world, group, model, data = self.world, self.world.group, self.world.model, self.world.data
        self.evaluations += len(level)
        chords = chords_of([segment.controls for segment in level])
        jacobians = np.empty((len(level), 6, model.nv))
        rows = jacobians if model.nv > 1 else jacobians[:, :, 0]  # of a single joint Pinocchio hands out a vector
        joints, joints_now = np.empty((len(level), model.njoints, 3, 4)), world.joint_placements
        for row, q in enumerate(group.expand_each(chords.middles)):
            rows[row] = pin.computeJointJacobians(model, data, q)
            joints[row] = joints_now
        moves = tangents(group, chords.middles, chords.chords) @ group.expand_velocity.T
        return joints, self._asked(level, chords, jacobians, joints.reshape(*joints.shape[:2], 12), moves)

    def _asked(
        self,
        level: Sequence[CurveSegment],
        chords: Chords,
        jacobians: np.ndarray,
        joints: np.ndarray,
        moves: ModelTangents,
    ) -> dict[int, list[_Asked]]:
        """The pairs in s segments that balls, boxes and slabs can't tell apart, by the segment, in ascending order.

        Args:
            level: The segments.
            chords: The boxes that they are in, and the straight ways that they are near.
            jacobians: Joint Jacobians at the middles in the world frame, shape (s, 6, nv of the model).
            joints: Placements there of the joints, shape (s, njoints, 12) [m].
            moves: Velocities of all joints there where those in the chart are the chords, shape (s, nv of the model).
        """
        robot, starts_left = self._robot, _left_of(level)
        given = self._obstacles, jacobians, joints, chords.half_widths, chords.chords, moves, chords.off
        error = CERTIFICATE.coal_relative, CERTIFICATE.coal_accuracy
        count, found = ROOM, np.empty((0, ASKED), np.int64)
        while count > len(found):
            found, told = np.empty((count, ASKED), np.int64), np.empty((count, TOLD))
            count = find_asked(robot, *given, self.min_clearance, *error, *starts_left, found, told)
        near: dict[int, list[_Asked]] = {}
        for (row, pair, first, second), (apart, bound, margin) in sorted(
            zip(found[:count].tolist(), told[:count].tolist(), strict=True)
        ):
            kept = 0.0 if pair < len(robot.own) else self.min_clearance
            near.setdefault(row, []).append((pair, first, second, bound, kept, margin, apart))
        return near

    def _left(self, placements: np.ndarray, asked: Sequence[_Asked]) -> list[_Left]:
        """Those of some pairs that are within their margins, the joints where they are told, shape (njoints, 3, 4) [m].

        Hulls are asked first, the meshes in them only where that does not tell. Those of which points were found that
        are within the margin needn't be asked about.
        """
        world, left, placed = self.world, [], False
        for pair, first, second, bound, kept, margin, told in asked:
            within, meshes = told <= margin, bound <= CERTIFICATE.mesh_from and world.is_hulled(pair)
            apart: float | None = told
            if meshes or not within:
                if not placed:
                    world.put_joints(placements)
                    placed = True
                if not within:
                    apart = world.penetration_of(first, second, margin, by_hulls=True)
                if apart is None or (meshes and world.penetration_of(first, second, margin) is None):
                    continue
            assert apart is not None, "it is within the margin"
            left.append(_Left(pair, first, second, bound, kept, apart, told=within and not meshes))
        return left

    def _refusal_at(self, rest: CurveSegment, segment: CurveSegment, left: list[_Left]) -> Verdict | None:
        """Why a segment is refused where its rest begins: it touches there, or the pairs left can't move any less."""
        z, place = rest.controls[0, 0], (rest.piece, rest.start)
        found = self._touching(z, left)
        if found is None:
            undecided = [one for one in left if one.bound <= self.floor]
            if not undecided:
                return None
            found = Reason.UNDECIDED, undecided[0].pair
            for ahead in places_ahead(_place(segment), place, len(self.pieces)):
                there = point_on(self.pieces[ahead[0]], ahead[1])
                touching = self._touching(there, undecided)
                if touching is not None:
                    found, z, place = touching, there, ahead
                    break
        return Verdict(
            found[0], self.evaluations, *place, _place(segment), self.world.pair_names(found[1]), chart_point=z
        )

    def _touching(self, z: ChartPoint, left: list[_Left]) -> tuple[Reason, int] | None:
        """What is wrong at a point (nv,) of the curve, contact or too close, and with which of some pairs; or None."""
        world, group = self.world, self.world.group
        self.evaluations += 1
        world.place(group.expand_from_chart(z))
        for one in left:
            if world.touches(one.pair):
                return Reason.CONTACT, one.pair
        for one in left:
            if one.kept > 0.0 and world.penetration(one.pair, one.kept) is not None:
                return Reason.TOO_CLOSE, one.pair
        return None


def _left_of(level: Sequence[CurveSegment]) -> tuple[np.ndarray, np.ndarray]:
    """The pairs that are left in segments.

    Returns:
        Where those of each begin, and the number of all, shape (s + 1,), and index and bodies of each, shape (k, 3).
        Of a segment in which none was judged before there are none.
    """
    left = [segment.pairs for segment in level if segment.pairs is not None]
    if not left:
        return np.zeros(len(level) + 1, np.int64), _NONE
    counts = (0 if segment.pairs is None else len(segment.pairs) for segment in level)
    return np.array([0, *accumulate(counts)]), np.concatenate(left)


_NONE = np.empty((0, 3), np.int64)
"""No pairs."""

_Asked = tuple[int, int, int, float, float, float, float]
"""A pair and its bodies; how much closer it can come within a segment, what it has to keep, what to ask Coal, and how
far apart it is at most as far as that is known without Coal [m]."""


class _Left(NamedTuple):
    """A pair that is within its margin at a segment's middle.

    Attributes:
        pair: Its index.
        first, second: Its bodies.
        bound: How much closer it can come within the segment [m].
        kept: What it has to keep [m].
        apart: How far apart it is [m].
        told: Whether that is known without Coal, which may say any distance that is within the margin.
    """

    pair: int
    first: int
    second: int
    bound: float
    kept: float
    apart: float
    told: bool

    def asked_from(self, floor: float) -> float:
        """Coal is asked whether it touches once it can come closer by no more than this [m], however far apart it is.

        A pair in contact that is told is told to be close, and so asked about sooner.
        """
        return floor if self.told else CERTIFICATE.mesh_from


def _decided_share(left: Sequence[_Left]) -> float:
    """Of how large a share of a segment the pairs left would likely be told apart, by how far apart they are."""
    share = min([0.5, *((one.apart - one.kept) / one.bound for one in left if one.bound > 0.0)])
    return max(share, CERTIFICATE.least_share)
