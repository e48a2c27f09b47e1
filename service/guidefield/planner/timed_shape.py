"""From a motion that keeps a schedule to one whose shape and time are found together, among obstacles that move.

What is waiting stays waiting: until a departure the robot stands where it starts. What is moved is optimised as among
obstacles at rest, with every obstacle where it is at the time, and the departure besides, where there is a wait. It is
taken if it is better and certified in time; else the motion stays the scheduled one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import cast

import numpy as np

from guidefield.planner.finish import HURRIED, NO_PLANES, Crossed, Finished, settings_of
from guidefield.planner.judgement import judged_in_time
from guidefield.planner.motion.limit_load import at_limits, limit_load
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.motion.waypoints import distinct
from guidefield.planner.optimize.optimization import Outcome, optimize
from guidefield.planner.optimize.worth import better
from guidefield.planner.path_motion import limits_of
from guidefield.planner.schedule.retimed import later
from guidefield.planner.schedule.standing import free_from, met, stays_free
from guidefield.planner.task.problem import Problem
from guidefield.planner.task.stages import Stages
from guidefield.planner.timed_guide import TimedPath
from guidefield.prove.verdict import Verdict
from guidefield.robot.model.spaces import ChartPoints

Judge = Callable[[Trajectory], Verdict]
"""Judges a motion in time."""


def shaped_across(problem: Problem, found: TimedPath, stages: Stages) -> Finished | None:
    """The optimised motion across guide planes; None where it isn't better than the one that was found, or refused.

    Args:
        problem: Robot, obstacles, guide planes, limits, deadline and most steps.
        found: The motion that was found.
        stages: Where time is counted.
    """
    motion = found.trajectory()
    if problem.optimization_iterations == 0 or len(distinct(motion.positions)) == 1:
        return None
    crossed = Crossed.of(problem, cast(ChartPoints, np.array(found.points)), found.crossings)
    judged = partial(judged_in_time, problem)
    leave_by = met(problem, problem.z_start)[0] if _moving_part(motion).times[0] > 0.0 else 0.0
    made, goal = _shaped(problem, motion, (leave_by, -np.inf), judged, stages, crossed), motion.positions[-1]
    if made is None or made.trajectory is None or stays_free(problem, goal, float(made.trajectory.times[-1])):
        return made
    if not stays_free(problem, goal, found.time):
        return made  # neither is the motion's end that was found
    return _shaped(problem, motion, (leave_by, free_from(problem, goal)), judged, stages, crossed)


def shaped_in_time(
    problem: Problem, scheduled: Finished, between: tuple[float, float], judged: Judge, stages: Stages
) -> Finished:
    """The optimised motion, or the scheduled one where that isn't better.

    Args:
        problem: Robot, obstacles, limits, deadline and most steps.
        scheduled: The motion from time 0 on, certified.
        between: Until when its start is free, and from when on its end is for good [s].
        judged: The certificate in time.
        stages: Where time is counted.
    """
    motion = scheduled.trajectory
    assert motion is not None, "it is certified"
    if problem.optimization_iterations == 0 or motion.duration == 0.0:
        return scheduled
    made = _shaped(problem, motion, between, judged, stages, NO_PLANES)
    return scheduled if made is None else replace(made, warnings=(*scheduled.warnings, *made.warnings))


def _shaped(
    problem: Problem,
    motion: Trajectory,
    between: tuple[float, float],
    judged: Judge,
    stages: Stages,
    crossed: Crossed,
) -> Finished | None:
    """The optimised motion from one that keeps a schedule and crosses guide planes; None where it is no better."""
    if problem.deadline.expired():
        return None
    begun, settings, (leave_by, arrive_from) = _moving_part(motion), settings_of(problem), between
    with stages.entered("relax", f"shape and time together, among what moves, {problem.objective.value}") as stage:
        optimized = optimize(problem, begun, settings, (), crossed.passages, leave_by=leave_by, arrive_from=arrive_from)
        stage.outcome = optimized.outcome.value
    if optimized.outcome is Outcome.NOT_PASSING:
        return None
    warnings = (HURRIED,) if optimized.outcome is Outcome.OUT_OF_TIME else ()
    for shaped in _within_limits(problem, optimized.trajectory, arrive_from):
        if not better(problem, shaped, begun, settings):
            continue
        with stages.entered("certify", "on the exact geometry, in time, between samples too") as stage:
            verdict = judged(whole := later(shaped))
            problem.counters.collision_checks += verdict.evaluations
            stage.outcome = verdict.reason.value
        if verdict.free:
            before = len(whole.times) - len(shaped.times)  # a knot, where it waits
            knots = {plane: before + at for plane, at in crossed.knots(optimized.trajectory, optimized.passed).items()}
            return Finished(verdict, whole.positions, knots, whole, warnings=warnings)
    return None


def _moving_part(motion: Trajectory) -> Trajectory:
    """A motion without the wait at its start."""
    stands = (motion.positions == motion.positions[0]).all(axis=1) & (motion.velocities == 0.0).all(axis=1)
    begin = int(np.argmin(stands)) - 1
    return Trajectory(motion.times[begin:], motion.positions[begin:], motion.velocities[begin:])


def _within_limits(problem: Problem, motion: Trajectory, arrive_from: float) -> Iterator[Trajectory]:
    """A motion as fast as it may go, if it doesn't arrive too soon then; and as it is, if it is within its limits."""
    begin, rates = float(motion.times[0]), limits_of(problem)
    knots = (motion.times - begin, motion.positions, motion.velocities)
    fast = at_limits(*knots, *rates)
    if begin + fast.duration >= arrive_from:
        yield Trajectory(begin + fast.times, fast.positions, fast.velocities)
    if limit_load(*knots, *rates) <= 1.0:
        yield motion
