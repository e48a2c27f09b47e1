"""Motions of steps joined past their goals: where the whole passes each goal, and whether it may be executed."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.motion_certificate import judge
from guidefield.planner.sequence.composed import part
from guidefield.planner.sequence.nearness import PassedGoal
from guidefield.planner.sequence.straight_certificate import certify_straight
from guidefield.planner.sequence.straight_way import StraightWay
from guidefield.planner.task.problem import Problem
from guidefield.prove.verdict import Verdict
from guidefield.read_only import ReadOnly


@dataclass(frozen=True, eq=False)
class Part:
    """The motion of one step among those that are joined, all in the chart of the first.

    Attributes:
        motion: Its motion, from rest to rest, which begins where the one before ends.
        goal: What is passed at its end; None for the last.
    """

    problem: Problem
    motion: Trajectory
    way: StraightWay | None
    goal: PassedGoal | None


@dataclass(frozen=True, eq=False)
class PassedAt(ReadOnly):
    """A goal that is passed, at knots of a motion.

    Attributes:
        entered, nearest, left: Knots at which the motion is within the radius for the first time, nearest to the goal,
            and there for the last time.
        distance: From the goal at `nearest`, as `PassedGoal.distances` [m, rad].
    """

    entered: int
    nearest: int
    left: int
    distance: float


@dataclass(frozen=True, eq=False)
class Joined(ReadOnly):
    """A motion past goals."""

    motion: Trajectory
    passages: tuple[PassedAt, ...]
    stops: bool = False


def slowest(parts: Sequence[Part]) -> Problem:
    """The first problem with the lowest limits of all."""
    first, groups = parts[0].problem, [one.problem.group for one in parts]
    velocities = np.stack([group.velocity_limits for group in groups]).min(axis=0)
    accelerations = np.stack([group.acceleration_limits for group in groups]).min(axis=0)
    group = dataclasses.replace(first.group, velocity_limits=velocities, acceleration_limits=accelerations)
    return dataclasses.replace(first, group=group)


def passed_about(goal: PassedGoal, motion: Trajectory, knots: tuple[int, int, int]) -> PassedAt:
    """Where a motion passes a goal.

    Args:
        knots: The first at which it may be, one at which it is within the radius, or nearest, and the last.
    """
    first, about, last = knots
    away = goal.distances(motion.positions[first : last + 1])
    outside, about = np.flatnonzero(away > goal.radius), about - first
    entered = min(int(outside[outside < about].max(initial=-1)) + 1, about)
    left = max(int(outside[outside > about].min(initial=len(away))) - 1, about)
    nearest = entered + int(np.argmin(away[entered : left + 1]))
    return PassedAt(first + entered, first + nearest, first + left, float(away[nearest]))


def find_refused_part(parts: Sequence[Part], joined: Joined) -> tuple[int, Verdict] | None:
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


def _judge_part(one: Part, motion: Trajectory, all_of: tuple[int, int], straight: tuple[int, int]) -> Verdict:
    """Return whether a part is free between two knots, and keeps to its way between two others."""
    problem = one.problem
    verdict = judge(problem, _between(motion, *all_of))
    if not verdict.free or one.way is None or straight[0] >= straight[1]:
        return verdict
    pieces = _between(motion, *straight).bezier()
    turns = problem.world.bodies.turns
    kept = certify_straight(one.way, problem.group, turns, pieces, problem.deadline)
    return dataclasses.replace(kept, evaluations=verdict.evaluations + kept.evaluations)


def _between(motion: Trajectory, first: int, last: int) -> Trajectory:
    """The part of a motion from one knot to another."""
    return part(motion, cast(float, motion.times[first]), cast(float, motion.times[last]))
