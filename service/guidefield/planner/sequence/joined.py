"""Motions of steps joined past their goals: where the whole passes each goal, and the certificate of its parts."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
import pinocchio as pin

from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.motion_certificate import judge_itself
from guidefield.planner.sequence.straight_way import StraightWay, certify_straight
from guidefield.planner.sequence.stretches import cut_trajectory
from guidefield.planner.task.motion_limits import take_lowest
from guidefield.planner.task.problem import Problem, TipGoal
from guidefield.prove.verdict import Verdict
from guidefield.read_only import ReadOnly
from guidefield.robot.model.spaces import ChartPoint, ChartPoints, ChartRate

INSIDE = 0.999
"""Share of a radius within which an optimised motion passes a goal: what is missed in the end is within the rest."""


@dataclass(frozen=True, eq=False)
class PassedGoal(ReadOnly):
    """The goal of a step that is passed."""

    problem: Problem
    z: ChartPoint  # where it would end, a chart point, shape (nv,)
    radius: float  # how far from there its way may be left [m, rad]

    @property
    def tip_plane(self) -> None:
        """It is no plane that the tip crosses, see `Place`."""
        return None

    @property
    def is_of_tip(self) -> bool:
        """True if it is about the tip."""
        return isinstance(self.problem.goal, TipGoal)

    @property
    def placement(self) -> pin.SE3:
        """Where the tip would be, a pinocchio.SE3 [m, world]."""
        return self._tip(self.z)

    def distances(self, zs: ChartPoints) -> np.ndarray:
        """How far chart points (k, nv) are from the goal, shape (k,).

        For a pose how far the tip is away [m] or turned [rad], whichever is more; else of the joint that is farthest
        [rad or m].
        """
        if not self.is_of_tip:
            away: np.ndarray = np.abs(zs - self.z).max(axis=1)
            return away
        here = self.placement
        return np.array([_distances(here, self._tip(z)) for z in zs])

    def missed(self, zs: ChartPoints) -> np.ndarray:
        """How far chart points (k, nv) are beyond the radius, as a place that a motion passes.

        Of a pose how far the tip is away and turned, shape (k, 2); else each coordinate, shape (k, nv).
        """
        if not self.is_of_tip:
            apart = np.abs(zs - self.z)
        else:
            here = self.placement
            apart = np.array([_differences(here, self._tip(z)) for z in zs])
        return np.maximum(apart - INSIDE * self.radius, 0.0)

    def rows(self, z: ChartPoint) -> np.ndarray:
        """The derivative of `missed` by the chart at a point (nv,), shape (2, nv) or (nv, nv)."""
        missed = self.missed(z[None])[0]
        if not self.is_of_tip:
            return np.diag(np.where(missed > 0.0, np.sign(z - self.z), 0.0))
        group, here, there = self.problem.group, self.placement, self._tip(z)
        J = self.problem.kinematics.tip_jacobian(group.expand_from_chart(z)) @ group.tangent_map(z)
        away, turned = there.translation - here.translation, pin.log3(there.rotation @ here.rotation.T)
        sizes = np.maximum([np.linalg.norm(away), np.linalg.norm(turned)], 1e-300)
        return np.where(missed[:, None] > 0.0, np.array([away @ J[:3], turned @ J[3:]]) / sizes[:, None], 0.0)

    def _tip(self, z: ChartPoint) -> pin.SE3:
        group = self.problem.group
        return self.problem.kinematics.frame_placement(group.expand_from_chart(z), group.tip_id)


def _distances(one: pin.SE3, other: pin.SE3) -> float:
    return max(_differences(one, other))


def _differences(one: pin.SE3, other: pin.SE3) -> tuple[float, float]:
    away = float(np.linalg.norm(other.translation - one.translation))
    return away, float(np.linalg.norm(pin.log3(one.rotation.T @ other.rotation)))


@dataclass(frozen=True, eq=False)
class StepPart:
    """The motion of one step among those that are joined, all in the chart of the first."""

    problem: Problem
    motion: Trajectory  # its motion, from rest to rest, which begins where the one before ends
    way: StraightWay | None
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
        least = dataclasses.replace(efforts[0], limits=cast(ChartRate, lowest))
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
    """Return whether a part is free between two knots, and keeps to its way between two others."""
    problem = one.problem
    verdict = judge_itself(problem, _cut(motion, *all_of))
    if not verdict.free or one.way is None or straight[0] >= straight[1]:
        return verdict
    pieces = _cut(motion, *straight).bezier()
    turns = problem.world.bodies.turns
    kept = certify_straight(one.way, problem.group, turns, pieces, problem.deadline)
    return dataclasses.replace(kept, evaluations=verdict.evaluations + kept.evaluations)


def _cut(motion: Trajectory, first: int, last: int) -> Trajectory:
    return cut_trajectory(motion, cast(float, motion.times[first]), cast(float, motion.times[last]))
