"""Motions one after the other as one trajectory of all joints, and the certificate of each stretch of it.

A stretch is a part of a step with the same permitted contacts, and the same straight way or none, all along.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import cast

import numpy as np

from guidefield.collision.world import World
from guidefield.deadline import UNLIMITED, Deadline
from guidefield.planner.motion.drawn_motion import DrawnMotion
from guidefield.planner.motion.given_motion import CurveKind, GivenMotion
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.motion_certificate import certify_from_start, choose_rows, find_enclosed_start, judge_drawn
from guidefield.planner.sequence.course import AllowedContact
from guidefield.planner.sequence.straight_way import StraightWay, certify_straight
from guidefield.planner.task.problem import Conditions, ControllerModel
from guidefield.prove.verdict import Verdict
from guidefield.read_only import ReadOnly
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.model.followers import follow
from guidefield.robot.model.spaces import (
    ChartPoint,
    ChartPoints,
    ChartRate,
    ChartRates,
    Configuration,
    RobotConfiguration,
)


@dataclass(frozen=True, eq=False)
class Embedding(ReadOnly):
    """The chart of some joints within that of more of them, while the others stand still."""

    base: ChartPoint  # where all joints are when the step begins, shape (n,) [rad or m]
    columns: np.ndarray  # where the step's coordinates stand among all, shape (k,)
    shift: np.ndarray  # whole turns by which all joints' angles are beyond the step's, shape (k,) [rad]

    @classmethod
    def of(cls, part: PlanningGroup, z_start: ChartPoint, whole: PlanningGroup, base: ChartPoint) -> Embedding:
        """The embedding of a group that begins at a chart point (k,), where all joints are at another (n,)."""
        at = {joint.name: joint for joint in whole.joints}
        columns = np.concatenate(
            [np.arange(at[joint.name].idx_v, at[joint.name].idx_v + joint.nv) for joint in part.joints]
        )
        turns = np.where(
            part.periods > 0.0,
            np.round((base[columns] - z_start) / np.maximum(part.periods, 1.0)),
            0.0,
        )
        return cls(base, columns, turns * part.periods)

    def points(self, zs: ChartPoints) -> ChartPoints:
        """Chart points of all joints, shape (m, n), of the step's, shape (m, k)."""
        points = np.repeat(self.base[None], len(zs), axis=0)
        points[:, self.columns] = zs + self.shift
        return cast(ChartPoints, points)

    def rates(self, rates: ChartRates) -> ChartRates:
        """Rates of all joints, shape (m, n), of the step's, shape (m, k)."""
        embedded = np.zeros((len(rates), len(self.base)))
        embedded[:, self.columns] = rates
        return cast(ChartRates, embedded)


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
        z: Where it begins, a chart point, shape (n,).
    """

    def __init__(self, z: ChartPoint) -> None:
        self._times = [0.0]
        self._positions: list[ChartPoint] = [z]
        self._velocities: list[ChartRate] = [cast(ChartRate, np.zeros(len(z)))]

    @property
    def end(self) -> float:
        """When it ends [s]."""
        return self._times[-1]

    @property
    def z(self) -> ChartPoint:
        """Where it ends, a chart point, shape (n,)."""
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
            self._velocities.append(cast(ChartRate, np.zeros(len(self.z))))

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
class Stretch(Conditions):
    """A part of a sequence's trajectory, and what it is judged by."""

    index: int
    motion: Trajectory
    way: StraightWay | None = None
    drawn: GivenMotion | None = None  # what a controller draws of it; None: the motion itself is executed

    @property
    def executed(self) -> Trajectory | GivenMotion:
        """What a robot executes of it."""
        return self.motion if self.drawn is None else self.drawn

    def drawn_of(self, whole: GivenMotion, *, is_last: bool) -> Stretch:
        """The same with its part of what a controller draws of the whole, which may end after the motion."""
        begin, end = float(self.motion.times[0]), float(self.motion.times[-1])
        until = (len(whole.pieces) - 1, 1.0) if is_last else whole.place_at(end)
        return dataclasses.replace(self, drawn=whole.between(whole.place_at(begin), until))


def make_stretches(
    index: int,
    conditions: Conditions,
    trajectory: Trajectory,
    span: tuple[float, float],
    permissions: Sequence[AllowedContact],
    way: StraightWay | None,
    straight: tuple[float, float],
) -> list[Stretch]:
    """The stretches of a step.

    Args:
        trajectory: The sequence's, with a knot wherever a permission, or a straight way, begins or ends.
        span: When the step begins and ends [s].
        straight: From when to when it goes straight [s]; not at all where that is no time.
    """
    begin, end = span
    changes = [time for one in permissions for time in (one.begin, one.end)] + list(straight if way else ())
    cuts = {time for time in changes if begin < time < end}
    fields = {field.name: getattr(conditions, field.name) for field in dataclasses.fields(Conditions)}
    stretches = []
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
        stretches.append(Stretch(**fields, index=index, motion=motion, way=way if kept else None))
    return stretches


def settle_stretches(
    trajectory: Trajectory, execution: ControllerModel, stretches: Sequence[Stretch], deadline: Deadline
) -> tuple[DrawnMotion, list[Stretch], list[Verdict]]:
    """Choose the rows that a controller is sent of all stretches, as `choose_rows`.

    Returns what is drawn, each stretch with its part of it, and the verdicts up to the first that isn't free.
    """
    parts, verdicts = list[Stretch](), list[Verdict]()

    def judge_motion(motion: GivenMotion) -> tuple[Verdict, float]:
        nonlocal parts, verdicts
        last = len(stretches) - 1
        parts, verdicts = [one.drawn_of(motion, is_last=k == last) for k, one in enumerate(stretches)], []
        stretched = 1.0
        for one in parts:
            verdict, most = certify_stretch(one, deadline)
            verdicts.append(verdict)
            stretched = max(stretched, most)
            if not verdict.free:
                break
        return verdicts[-1], stretched

    settled = choose_rows(trajectory, execution, deadline, judge_motion)
    if not settled.is_kept:  # the motion itself was judged after it
        judge_motion(settled.drawn.motion)
    return settled.drawn, parts, verdicts


def certify_stretch(stretch: Stretch, deadline: Deadline = UNLIMITED) -> tuple[Verdict, float]:
    """Judge a stretch: free, and keeping what the step has to keep; and `SettledExecution.stretch`."""
    drawn, stretched = stretch.drawn, 1.0
    if drawn is None:
        verdict, pieces = certify_from_start(stretch, stretch.motion, deadline), stretch.motion.bezier()
    else:
        begin, pieces = drawn.along(0, 0.0)[1] or 0.0, drawn.straight if drawn.kind is CurveKind.STEPS else drawn.pieces
        inside = find_enclosed_start(stretch, drawn.start, begin)
        verdict, stretched = judge_drawn(stretch, drawn, deadline) if inside is None else (inside, 1.0)
    if not verdict.free or stretch.way is None:
        return verdict, stretched
    kept = certify_straight(stretch.way, stretch.group, stretch.world.bodies.turns, pieces, deadline)
    return dataclasses.replace(kept, evaluations=verdict.evaluations + kept.evaluations), stretched
