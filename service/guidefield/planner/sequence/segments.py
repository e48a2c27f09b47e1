"""Motions one after the other as one trajectory of all joints: joined past goals, each segment certified.

A segment is a part of a step with the same permitted contacts, and with one straight line or none. `INSIDE` is the one
setting.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import cast

import numpy as np
import pinocchio as pin

from guidefield.collision.world import World
from guidefield.deadline import UNLIMITED, Deadline
from guidefield.planner.motion.drawn_motion import DrawnMotion
from guidefield.planner.motion.submitted_motion import CurveKind, SubmittedMotion
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.motion_certificate import (
    certify_from_start,
    choose_rows,
    find_enclosed_start,
    judge_drawn,
    judge_itself,
)
from guidefield.planner.sequence.cartesian_line import CartesianLine, certify_straight
from guidefield.planner.sequence.step_sequence import AllowedContact
from guidefield.planner.task.motion_limits import take_lowest
from guidefield.planner.task.problem import Conditions, ControllerModel, Problem, TipGoal
from guidefield.prove.verdict import Verdict
from guidefield.read_only import ReadOnly
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.model.joints import (
    Configuration,
    LocalPoint,
    LocalPoints,
    LocalRate,
    LocalRates,
    RobotConfiguration,
)
from guidefield.robot.model.mimic_joints import follow


@dataclass(frozen=True, eq=False)
class Embedding(ReadOnly):
    """Local coordinates of some joints among those of more, while the others stand still."""

    base: LocalPoint  # where all joints are when the step begins, shape (n,) [rad or m]
    columns: np.ndarray  # where the step's coordinates stand among all, shape (k,)
    shift: np.ndarray  # whole turns by which all joints' angles are beyond the step's, shape (k,) [rad]

    @classmethod
    def of(cls, part: PlanningGroup, z_start: LocalPoint, whole: PlanningGroup, base: LocalPoint) -> Embedding:
        """The embedding of a group that begins at local coordinates (k,), where all joints are at another (n,)."""
        at = {joint.name: joint for joint in whole.joints}
        columns = np.concatenate(
            [np.arange(at[joint.name].idx_v, at[joint.name].idx_v + joint.nv) for joint in part.joints]
        )
        turns = np.where(part.periods > 0.0, np.round((base[columns] - z_start) / np.maximum(part.periods, 1.0)), 0.0)
        return cls(base, columns, turns * part.periods)

    def points(self, zs: LocalPoints) -> LocalPoints:
        """Local coordinates of all joints, shape (m, n), of the step's, shape (m, k)."""
        points = np.repeat(self.base[None], len(zs), axis=0)
        points[:, self.columns] = zs + self.shift
        return cast(LocalPoints, points)

    def rates(self, rates: LocalRates) -> LocalRates:
        """Rates of all joints, shape (m, n), of the step's, shape (m, k)."""
        embedded = np.zeros((len(rates), len(self.base)))
        embedded[:, self.columns] = rates
        return cast(LocalRates, embedded)


def whole_configuration(group: PlanningGroup, q: Configuration) -> RobotConfiguration:
    """Configuration of the whole robot, shape (nq of the robot,), with a group's joints at q (nq,), others unmoved."""
    whole = np.array(group.q_reference, float)
    for joint in group.joints:
        among = group.robot.joint(joint.name)
        assert among is not None, "a group's joints are the robot's"
        whole[among.idx_q : among.idx_q + among.nq] = q[joint.idx_q : joint.idx_q + joint.nq]
    follow(group.robot.joints, whole)
    return cast(RobotConfiguration, whole)


class Composition:
    """A trajectory of all joints that grows at its end.

    Args:
        z: Where it begins, local coordinates, shape (n,).
    """

    def __init__(self, z: LocalPoint) -> None:
        self._times = [0.0]
        self._positions: list[LocalPoint] = [z]
        self._velocities: list[LocalRate] = [cast(LocalRate, np.zeros(len(z)))]

    @property
    def end(self) -> float:
        """Its end [s]."""
        return self._times[-1]

    @property
    def z(self) -> LocalPoint:
        """Local coordinates of its end, shape (n,)."""
        return self._positions[-1]

    def move(self, motion: Trajectory, embedding: Embedding) -> list[float]:
        """Go on along a motion that begins where this ends; returns when it is at each of its knots [s]."""
        first, since = len(self._times) - 1, self.end - float(motion.times[0])
        self._times += (since + motion.times[1:]).tolist()
        self._positions += list(embedding.points(motion.positions)[1:])
        self._velocities += list(embedding.rates(motion.velocities)[1:])
        return self._times[first:]

    def wait(self, until: float) -> None:
        """Stay until a time [s]."""
        if until > self.end:
            self._times.append(until)
            self._positions.append(self.z)
            self._velocities.append(cast(LocalRate, np.zeros(len(self.z))))

    def trajectory(self) -> Trajectory:
        """As it is by now."""
        return Trajectory(np.array(self._times), np.array(self._positions), np.array(self._velocities))


def insert_knots(trajectory: Trajectory, times: Iterable[float]) -> Trajectory:
    """The same curve with knots at some more times [s]."""
    inner = [time for time in times if trajectory.times[0] < time < trajectory.times[-1]]
    more = np.setdiff1d(np.array(inner, float), trajectory.times)
    if not len(more):
        return trajectory
    positions, velocities, _ = trajectory.evaluate(more)
    order = np.argsort(np.concatenate([trajectory.times, more]), kind="stable")
    return Trajectory(
        np.concatenate([trajectory.times, more])[order],
        np.concatenate([trajectory.positions, positions])[order],
        np.concatenate([trajectory.velocities, velocities])[order],
        trajectory.stretch,
    )


def cut_trajectory(trajectory: Trajectory, begin: float, end: float) -> Trajectory:
    """The part of a trajectory between two of its knots [s]; its times stay what they are."""
    first, last = np.searchsorted(trajectory.times, [begin, end])
    rows = slice(first, last + 1)
    return Trajectory(trajectory.times[rows], trajectory.positions[rows], trajectory.velocities[rows])


@dataclass(frozen=True, eq=False, kw_only=True)
class SequenceSegment(Conditions):
    """A part of a sequence's trajectory, with the conditions that it has to meet."""

    index: int
    motion: Trajectory
    line: CartesianLine | None = None
    drawn: SubmittedMotion | None = None  # what a controller draws of it; None: the motion itself is executed

    @property
    def executed(self) -> Trajectory | SubmittedMotion:
        """The motion that a robot executes."""
        return self.motion if self.drawn is None else self.drawn

    def drawn_of(self, whole: SubmittedMotion, *, is_last: bool) -> SequenceSegment:
        """The same with its part of what a controller draws of the whole, which may end after the motion."""
        begin, end = float(self.motion.times[0]), float(self.motion.times[-1])
        until = (len(whole.pieces) - 1, 1.0) if is_last else whole.place_at(end)
        return dataclasses.replace(self, drawn=whole.between(whole.place_at(begin), until))


def make_segments(
    index: int,
    conditions: Conditions,
    trajectory: Trajectory,
    span: tuple[float, float],
    permissions: Sequence[AllowedContact],
    line: CartesianLine | None,
    straight: tuple[float, float],
) -> list[SequenceSegment]:
    """The segments of a step.

    Args:
        trajectory: The sequence's, with a knot wherever a permission, or a straight line, begins or ends.
        span: When the step begins and ends [s].
        straight: From when to when it goes straight [s]; not at all where that is no time.
    """
    begin, end = span
    changes = [time for one in permissions for time in (one.begin, one.end)] + list(straight if line else ())
    cuts = {time for time in changes if begin < time < end}
    fields = {field.name: getattr(conditions, field.name) for field in dataclasses.fields(Conditions)}
    segments = []
    for first, last in pairwise([begin, *sorted(cuts), end]):
        touches = [one.touch for one in permissions if one.covers(first, last)]
        if touches:
            pairs = conditions.allowed_collisions.union(touches)
            fields["allowed_collisions"] = pairs
            fields["world"] = World.build(conditions.group, conditions.scene, pairs)
        else:
            fields["allowed_collisions"], fields["world"] = conditions.allowed_collisions, conditions.world
        kept = straight[0] < straight[1] and straight[0] <= first and last <= straight[1]
        motion = cut_trajectory(trajectory, first, last)
        segments.append(SequenceSegment(**fields, index=index, motion=motion, line=line if kept else None))
    return segments


def choose_segment_rows(
    trajectory: Trajectory, execution: ControllerModel, segments: Sequence[SequenceSegment], deadline: Deadline
) -> tuple[DrawnMotion, list[SequenceSegment], list[Verdict]]:
    """Choose the rows that a controller is sent of all segments, as `choose_rows`.

    Returns what is drawn, each segment with its part of it, and the verdicts up to the first that isn't free.
    """
    parts, verdicts = list[SequenceSegment](), list[Verdict]()

    def judge_motion(motion: SubmittedMotion) -> tuple[Verdict, float]:
        nonlocal parts, verdicts
        last = len(segments) - 1
        parts, verdicts = [one.drawn_of(motion, is_last=k == last) for k, one in enumerate(segments)], []
        stretched = 1.0
        for one in parts:
            verdict, most = certify_segment(one, deadline)
            verdicts.append(verdict)
            stretched = max(stretched, most)
            if not verdict.free:
                break
        return verdicts[-1], stretched

    chosen = choose_rows(trajectory, execution, deadline, judge_motion)
    if not chosen.is_kept:  # the last verdict is that of the motion itself
        judge_motion(chosen.drawn.motion)
    return chosen.drawn, parts, verdicts


def certify_segment(segment: SequenceSegment, deadline: Deadline = UNLIMITED) -> tuple[Verdict, float]:
    """Judge a segment: free, and within its step's conditions; and `motion_certificate.ChosenExecution.stretch`."""
    drawn, stretched = segment.drawn, 1.0
    if drawn is None:
        verdict, pieces = certify_from_start(segment, segment.motion, deadline), segment.motion.bezier()
    else:
        begin, pieces = drawn.along(0, 0.0)[1] or 0.0, drawn.straight if drawn.kind is CurveKind.STEPS else drawn.pieces
        inside = find_enclosed_start(segment, drawn.start, begin)
        verdict, stretched = judge_drawn(segment, drawn, deadline) if inside is None else (inside, 1.0)
    if not verdict.free or segment.line is None:
        return verdict, stretched
    kept = certify_straight(segment.line, segment.group, segment.world.bodies.turns, pieces, deadline)
    return dataclasses.replace(kept, evaluations=verdict.evaluations + kept.evaluations), stretched


INSIDE = 0.999
"""Share of a radius within which an optimised motion passes a goal: what is missed in the end (`passages.REACHED`) is
within the rest of radii from a millimetre on; `find_refused_part` refuses what doesn't pass it."""


@dataclass(frozen=True, eq=False)
class PassedGoal(ReadOnly):
    """The goal of a step that is passed."""

    problem: Problem
    z: LocalPoint  # where it would end, local coordinates, shape (nv,)
    radius: float  # how far from there its path may be left [m, rad]

    @property
    def tip_plane(self) -> None:
        """It is no plane that the tip crosses, see `passages.Place`."""
        return None

    @property
    def is_of_tip(self) -> bool:
        """True if it is about the tip."""
        return isinstance(self.problem.goal, TipGoal)

    @property
    def placement(self) -> pin.SE3:
        """The tip's placement at the goal, a pinocchio.SE3 [m, world]."""
        return self._tip(self.z)

    def distances(self, zs: LocalPoints) -> np.ndarray:
        """Distances of local coordinates (k, nv) from the goal, shape (k,).

        For a pose how far the tip is away [m] or turned [rad], whichever is more; else of the joint that is farthest
        [rad or m].
        """
        if not self.is_of_tip:
            away: np.ndarray = np.abs(zs - self.z).max(axis=1)
            return away
        here = self.placement
        return np.array([_distances(here, self._tip(z)) for z in zs])

    def misses(self, zs: LocalPoints) -> np.ndarray:
        """Distances of local coordinates (k, nv) beyond the radius, as a place that a motion passes.

        Of a pose how far the tip is away and turned, shape (k, 2); else each coordinate, shape (k, nv).
        """
        if not self.is_of_tip:
            apart = np.abs(zs - self.z)
        else:
            here = self.placement
            apart = np.array([_differences(here, self._tip(z)) for z in zs])
        return np.maximum(apart - INSIDE * self.radius, 0.0)

    def rows(self, z: LocalPoint) -> np.ndarray:
        """The derivative of `missed` by local coordinates z (nv,), shape (2, nv) or (nv, nv)."""
        missed = self.misses(z[None])[0]
        if not self.is_of_tip:
            return np.diag(np.where(missed > 0.0, np.sign(z - self.z), 0.0))
        group, here, there = self.problem.group, self.placement, self._tip(z)
        J = self.problem.kinematics.tip_jacobian(group.expand_from_local(z)) @ group.tangent_map(z)
        away, turned = there.translation - here.translation, pin.log3(there.rotation @ here.rotation.T)
        sizes = np.maximum([np.linalg.norm(away), np.linalg.norm(turned)], 1e-300)
        return np.where(missed[:, None] > 0.0, np.array([away @ J[:3], turned @ J[3:]]) / sizes[:, None], 0.0)

    def _tip(self, z: LocalPoint) -> pin.SE3:
        group = self.problem.group
        return self.problem.kinematics.frame_placement(group.expand_from_local(z), group.tip_id)


def _distances(one: pin.SE3, other: pin.SE3) -> float:
    return max(_differences(one, other))


def _differences(one: pin.SE3, other: pin.SE3) -> tuple[float, float]:
    away = float(np.linalg.norm(other.translation - one.translation))
    return away, float(np.linalg.norm(pin.log3(one.rotation.T @ other.rotation)))


@dataclass(frozen=True, eq=False)
class StepPart:
    """The motion of one step among those that are joined, all in local coordinates of the first."""

    problem: Problem
    motion: Trajectory  # its motion, from rest to rest, which begins where the one before ends
    line: CartesianLine | None
    goal: PassedGoal | None  # what is passed at its end; None for the last


@dataclass(frozen=True, eq=False)
class GoalPassage(ReadOnly):
    """A goal that is passed, at knots of a motion."""

    # knots at which the motion is within the radius for the first time, nearest to the goal, and there for the last
    # time
    entered: int
    nearest: int
    left: int
    distance: float  # from the goal at `nearest`, as `PassedGoal.distances` [m, rad]


@dataclass(frozen=True, eq=False)
class JoinedMotion(ReadOnly):
    """A motion past goals."""

    motion: Trajectory
    passages: tuple[GoalPassage, ...]
    stops: bool = False


def find_slowest(parts: Sequence[StepPart]) -> Problem:
    """The first problem with the lowest limits of all."""
    first, groups = parts[0].problem, [one.problem.group for one in parts]
    velocities = np.stack([group.velocity_limits for group in groups]).min(axis=0)
    accelerations = np.stack([group.acceleration_limits for group in groups]).min(axis=0)
    group = dataclasses.replace(first.group, velocity_limits=velocities, acceleration_limits=accelerations)
    limits = take_lowest([limit for one in parts for limit in one.problem.cartesian_limits])
    efforts = [one.problem.effort_limit for one in parts if one.problem.effort_limit is not None]
    least = None
    if efforts:
        lowest = np.min([one.limits for one in efforts], axis=0)
        least = dataclasses.replace(efforts[0], limits=cast(LocalRate, lowest))
    return dataclasses.replace(first, group=group, cartesian_limits=limits, effort_limit=least)


def find_passage(goal: PassedGoal, motion: Trajectory, knots: tuple[int, int, int]) -> GoalPassage:
    """Find where a motion passes a goal.

    Args:
        knots: The first at which it may be, one at which it is within the radius, or nearest, and the last.
    """
    first, about, last = knots
    away = goal.distances(motion.positions[first : last + 1])
    outside, about = np.flatnonzero(away > goal.radius), about - first
    entered = min(int(outside[outside < about].max(initial=-1)) + 1, about)
    left = max(int(outside[outside > about].min(initial=len(away))) - 1, about)
    nearest = entered + int(np.argmin(away[entered : left + 1]))
    return GoalPassage(first + entered, first + nearest, first + left, float(away[nearest]))


def find_refused_part(parts: Sequence[StepPart], joined: JoinedMotion) -> tuple[int, Verdict] | None:
    """The first part that isn't certified, or doesn't pass its goal, and the certificate's verdict of it; None: all do.

    Of a part that is free, but doesn't pass its goal, the verdict says that it is free.
    """
    motion, passages = joined.motion, joined.passages
    marks = [0, *(one.nearest for one in passages), len(motion.times) - 1]
    kept = [0, *(one.left for one in passages)], [*(one.entered for one in passages), len(motion.times) - 1]
    for k, one in enumerate(parts):
        verdict = _judge_part(one, motion, (marks[k], marks[k + 1]), (kept[0][k], kept[1][k]))
        one.problem.counters.collision_checks += verdict.evaluations
        if not verdict.free or (one.goal is not None and passages[k].distance > one.goal.radius):
            return k, verdict
    return None


def _judge_part(one: StepPart, motion: Trajectory, all_of: tuple[int, int], straight: tuple[int, int]) -> Verdict:
    """Return whether a part is free between two knots, and keeps to its line between two others."""
    problem = one.problem
    verdict = judge_itself(problem, _cut(motion, *all_of))
    if not verdict.free or one.line is None or straight[0] >= straight[1]:
        return verdict
    pieces = _cut(motion, *straight).bezier()
    turns = problem.world.bodies.turns
    kept = certify_straight(one.line, problem.group, turns, pieces, problem.deadline)
    return dataclasses.replace(kept, evaluations=verdict.evaluations + kept.evaluations)


def _cut(motion: Trajectory, first: int, last: int) -> Trajectory:
    return cut_trajectory(motion, cast(float, motion.times[first]), cast(float, motion.times[last]))
