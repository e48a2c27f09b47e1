"""Motions one after the other as one that doesn't stop between them: corners rounded, timed as a whole, certified.

Away from its corners the motion goes along the curves that were planned for the steps; a corner lies within the radius
of the goal that is passed. What the certificate refuses is rounded more tightly. As fast as possible along these curves
is as fast as any, but for limits of jerk: with these, and where no step has to keep to its curve, each is optimised
from the state in which one goal is passed to that of the next.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import cast

import numpy as np

from guidefield.collision.certify.verdict import Reason, Verdict
from guidefield.errors import Status
from guidefield.planner.finish import judged, optimized_motion, soonest_along, through
from guidefield.planner.in_motion import joined as in_sequence
from guidefield.planner.motion.jerk import parameterize_gently
from guidefield.planner.motion.timing import parameterize
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.sequence.composed import part
from guidefield.planner.sequence.corners import Curve, Rounded, rounded
from guidefield.planner.sequence.nearness import PassedGoal
from guidefield.planner.sequence.straight_certificate import certify_straight
from guidefield.planner.sequence.straight_way import StraightWay
from guidefield.planner.task.ending import Ending
from guidefield.planner.task.problem import Problem
from guidefield.planner.task.refusal import refusal
from guidefield.planner.task.stages import Stages
from guidefield.read_only import ReadOnly


@dataclass(frozen=True)
class PassingSettings:
    """Numbers of passing.

    Attributes:
        spacing: Between places of the path that is timed, at most [rad or m].
        tries: Motions that are judged at most.
        tighter: The corners next to what is refused are this much smaller the next time.
        denser: Places, and the pieces of a motion with limits of jerk, are so many times as dense the next time where
            a way, or a goal, isn't kept to.
        densest: So many times as dense at most.
        speeds: Shares of the speed along the corners without limits of jerk with which goals are passed where steps are
            optimised, tried while they make the motion shorter.
    """

    spacing: float = 0.03
    tries: int = 10
    tighter: float = 0.5
    denser: int = 2
    densest: int = 32
    speeds: tuple[float, ...] = (1.0, 0.75, 0.5)


PASSING = PassingSettings()


@dataclass(frozen=True, eq=False)
class Part:
    """The motion of one step among those that are joined, all in the chart of the first.

    Attributes:
        problem: The step's.
        motion: Its motion, from rest to rest, which begins where the one before ends.
        way: The straight way of the tip, if it goes straight.
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
    """A motion that passes goals without stopping.

    Attributes:
        motion: The motion, certified.
        passages: One for each goal.
    """

    motion: Trajectory
    passages: tuple[PassedAt, ...]


@dataclass(frozen=True, eq=False)
class NotJoined(ReadOnly):
    """Why motions could not be joined.

    Attributes:
        part: Which part was refused.
        ending: Why.
        verdict: The certificate's, of that part.
    """

    part: int
    ending: Ending
    verdict: Verdict


def join(parts: Sequence[Part], stages: Stages) -> Joined | NotJoined:
    """Join motions of the same joints.

    Args:
        parts: Two or more, each certified by itself.
        stages: Where time is counted.
    """
    curves = [Curve(one.motion) for one in parts]
    goals = [one.goal for one in parts if one.goal is not None]
    radii, density = [goal.radius for goal in goals], 1
    slowest = _slowest(parts)
    refused: NotJoined | None = None
    for _ in range(PASSING.tries):
        with stages.entered("parameterize", "past the goals, as fast as the limits allow") as stage:
            path = rounded(curves, goals, radii, PASSING.spacing / density)
            motion = _timed(slowest, path, density)
            joined = Joined(motion, _passages(motion, path, goals))
            stage.outcome = f"{motion.duration:.3f} s"
        with stages.entered("certify", "between the goals and past them, between samples too") as stage:
            refused = _refused(parts, joined)
            stage.outcome = "free" if refused is None else refused.verdict.reason.value
        if refused is None:
            shaped = slowest.jerk_limits is not None and all(map(_is_free, parts))
            return _optimized(parts, joined, path, stages) if shaped else joined
        if (spent := slowest.budget.spent()) is not None:
            why = "the run was cancelled" if spent is Status.PREEMPTED else "time was up"
            ending = Ending(spent, f"{why} before a motion past the goals was certified", {"stage": "certify"})
            return dataclasses.replace(refused, ending=ending)
        coarse = refused.verdict.reason in (Reason.PATH_CONSTRAINT, Reason.FREE) and density < PASSING.densest
        if coarse:
            density *= PASSING.denser
        if not coarse or slowest.path_constraints:
            for k in (refused.part - 1, refused.part):
                if 0 <= k < len(radii):
                    radii[k] *= PASSING.tighter
    assert refused is not None, "it was judged"
    return refused


def _timed(problem: Problem, path: Rounded, density: int) -> Trajectory:
    """The motion along a path as fast as the limits allow, with so many times as many pieces where jerk is limited."""
    group, spline = problem.group, through(problem, path.path)
    if problem.jerk_limits is None:
        return parameterize(spline, group.velocity_limits, group.acceleration_limits)
    limits = group.velocity_limits, group.acceleration_limits, problem.jerk_limits
    return parameterize_gently(spline, *limits, finer=density)


def _is_free(one: Part) -> bool:
    """Whether a step may leave the curve that was planned for it."""
    problem = one.problem
    given = one.way is not None or problem.guide_planes or problem.path_constraints
    moves = one.motion.duration > 0.0
    return moves and not given and problem.group.is_euclidean and problem.optimization_iterations != 0


def _optimized(parts: Sequence[Part], joined: Joined, path: Rounded, stages: Stages) -> Joined:
    """The shortest of a motion and those whose steps are optimised, as they pass the goals at several speeds."""
    slowest, best = _slowest(parts), joined
    along = soonest_along(slowest, path.path)
    passages = _passages(along, path, [one.goal for one in parts if one.goal is not None])
    marks = [0, *(one.nearest for one in passages), len(along.times) - 1]
    distances = [one.distance for one in passages]
    if any(one.goal is not None and away > one.goal.radius for one, away in zip(parts, distances, strict=False)):
        return joined
    for speed in PASSING.speeds:
        found = []
        for one, (first, last) in zip(parts, pairwise(marks), strict=True):
            finished = _at_speed(one, _between(along, first, last), speed, stages)
            if finished is None:
                break
            found.append(finished)
        if len(found) < len(parts):
            continue
        motion = in_sequence(found)
        if motion.duration >= best.motion.duration:
            break
        knots = np.cumsum([len(one.times) - 1 for one in found[:-1]]).tolist()
        best = Joined(motion, tuple(PassedAt(k, k, k, away) for k, away in zip(knots, distances, strict=True)))
    return best


def _at_speed(one: Part, motion: Trajectory, speed: float, stages: Stages) -> Trajectory | None:
    """A step's motion optimised, certified, with a share of the velocities at its ends; None where there is none."""
    slower = Trajectory((motion.times - motion.times[0]) / speed, motion.positions, speed * motion.velocities)
    if one.problem.budget.spent():
        return None
    asked = dataclasses.replace(one.problem, start_velocity=slower.velocities[0], end_velocity=slower.velocities[-1])
    finished = optimized_motion(asked, slower, iter(()), stages)
    return None if finished is None or not finished.verdict.free else finished.trajectory


def _slowest(parts: Sequence[Part]) -> Problem:
    """The first problem with the lowest limits of all."""
    first, groups = parts[0].problem, [one.problem.group for one in parts]
    velocities = np.stack([group.velocity_limits for group in groups]).min(axis=0)
    accelerations = np.stack([group.acceleration_limits for group in groups]).min(axis=0)
    group = dataclasses.replace(first.group, velocity_limits=velocities, acceleration_limits=accelerations)
    return dataclasses.replace(first, group=group)


def _passages(motion: Trajectory, path: Rounded, goals: Sequence[PassedGoal]) -> tuple[PassedAt, ...]:
    """Where the motion passes each goal: about the middle of its corner, by length."""
    travelled = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(motion.positions, axis=0), axis=1))]
    lengths = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(path.path, axis=0), axis=1))]
    lengths *= travelled[-1] / max(lengths[-1], 1e-300)
    bounds = [0.0, *(0.5 * (lengths[a[1]] + lengths[b[0]]) for a, b in pairwise(path.corners)), travelled[-1]]
    passages = []
    for k, (goal, (begin, end)) in enumerate(zip(goals, path.corners, strict=True)):
        first, last = np.searchsorted(travelled, bounds[k]), np.searchsorted(travelled, bounds[k + 1], side="right") - 1
        away = goal.distances(motion.positions[first : last + 1])
        in_corner = slice(*(np.searchsorted(travelled, lengths[[begin, end]]) - first + (-1, 2)).clip(0, len(away)))
        nearest = in_corner.start + int(np.argmin(away[in_corner]))
        outside = np.flatnonzero(away > goal.radius)
        entered = int(outside[outside < nearest].max(initial=-1)) + 1
        left = int(outside[outside > nearest].min(initial=len(away))) - 1
        passages.append(PassedAt(int(first) + entered, int(first) + nearest, int(first) + left, float(away[nearest])))
    return tuple(passages)


def _refused(parts: Sequence[Part], joined: Joined) -> NotJoined | None:
    """The first part that isn't certified, or doesn't pass its goal; None where all are, and do."""
    motion, passages = joined.motion, joined.passages
    marks = [0, *(one.nearest for one in passages), len(motion.times) - 1]
    kept = [0, *(one.left for one in passages)], [*(one.entered for one in passages), len(motion.times) - 1]
    for k, one in enumerate(parts):
        verdict = _judged(one, motion, (marks[k], marks[k + 1]), (kept[0][k], kept[1][k]))
        one.problem.counters.collision_checks += verdict.evaluations
        if not verdict.free:
            return NotJoined(k, _ending(one.problem, verdict), verdict)
        if one.goal is not None and passages[k].distance > one.goal.radius:
            return NotJoined(k, _passed_by(passages[k], one.goal), verdict)
    return None


def _judged(one: Part, motion: Trajectory, all_of: tuple[int, int], straight: tuple[int, int]) -> Verdict:
    """Whether a part is free between two knots, and keeps to its way between two others."""
    problem = one.problem
    verdict = judged(problem, _between(motion, *all_of).bezier())
    if not verdict.free or one.way is None or straight[0] >= straight[1]:
        return verdict
    pieces = _between(motion, *straight).bezier()
    turns = problem.world.bodies.turns
    kept = certify_straight(one.way, problem.group, turns, pieces, problem.budget.spent)
    return dataclasses.replace(kept, evaluations=verdict.evaluations + kept.evaluations)


def _between(motion: Trajectory, first: int, last: int) -> Trajectory:
    """The part of a motion from one knot to another."""
    return part(motion, cast(float, motion.times[first]), cast(float, motion.times[last]))


def _ending(problem: Problem, verdict: Verdict) -> Ending:
    """How a part ended that was refused."""
    ended = refusal(problem, verdict)
    if ended.status in (Status.TIMED_OUT, Status.PREEMPTED):
        return ended
    message = f"no motion past the goals was certified, the tightest one neither: {ended.message}"
    return Ending(ended.status, message, ended.details)


def _passed_by(passage: PassedAt, goal: PassedGoal) -> Ending:
    """How a part ended that comes not near enough to its goal."""
    message = (
        f"no motion was found that passes the goal within its `radius` of {goal.radius:.6g}: this one is"
        f" {passage.distance:.6g} away"
    )
    return Ending(Status.INVALID_MOTION_PLAN, message, {"stage": "parameterize", "distance": passage.distance})
