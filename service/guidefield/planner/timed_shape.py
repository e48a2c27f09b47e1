"""From a motion that keeps a schedule to one whose shape and time are found together, among obstacles that move.

What is waiting stays waiting: until a departure the robot stands where it starts. What is moved is optimised as among
obstacles at rest, with every obstacle where it is at the time, and the departure besides, where there is a wait. It is
taken if it is better and certified in time; else the motion stays the scheduled one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import cast

import numpy as np

from guidefield.collision.certify.verdict import Verdict
from guidefield.planner.finish import HURRIED, Finished, settings_of
from guidefield.planner.motion.limit_load import at_limits
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.optimize.optimization import Outcome, optimize
from guidefield.planner.optimize.worth import better
from guidefield.planner.schedule.retimed import later
from guidefield.planner.task.problem import Problem
from guidefield.planner.task.stages import Stages
from guidefield.robot.model.spaces import ChartRate


def shaped_in_time(
    problem: Problem,
    scheduled: Finished,
    between: tuple[float, float],
    judged: Callable[[Trajectory], Verdict],
    stages: Stages,
) -> Finished:
    """The optimised motion, or the scheduled one where that isn't better.

    Args:
        problem: Robot, obstacles, limits, budget and most steps.
        scheduled: The motion from time 0 on, certified.
        between: Until when its start is free, and from when on its end is for good [s].
        judged: The certificate in time.
        stages: Where time is counted.
    """
    motion, (leave_by, arrive_from) = scheduled.trajectory, between
    assert motion is not None, "it is certified"
    if problem.optimization_iterations == 0 or motion.duration == 0.0 or problem.budget.spent():
        return scheduled
    begun, settings = _moving_part(motion), settings_of(problem)
    with stages.entered("relax", f"shape and time together, among what moves, {problem.objective.value}") as stage:
        optimized = optimize(problem, begun, settings, leave_by=leave_by, arrive_from=arrive_from)
        stage.outcome = optimized.outcome.value
    warnings = (*scheduled.warnings, HURRIED) if optimized.outcome is Outcome.OUT_OF_TIME else scheduled.warnings
    for shaped in _at_limits(problem, optimized.trajectory, arrive_from):
        if not better(problem, shaped, begun, settings):
            continue
        with stages.entered("certify", "on the exact geometry, in time, between samples too") as stage:
            verdict = judged(whole := later(shaped))
            problem.counters.collision_checks += verdict.evaluations
            stage.outcome = verdict.reason.value
        if verdict.free:
            return replace(scheduled, verdict=verdict, path=whole.positions, trajectory=whole, warnings=warnings)
    return scheduled


def _moving_part(motion: Trajectory) -> Trajectory:
    """A motion without the wait at its start."""
    stands = (motion.positions == motion.positions[0]).all(axis=1) & (motion.velocities == 0.0).all(axis=1)
    begin = int(np.argmin(stands)) - 1
    return Trajectory(motion.times[begin:], motion.positions[begin:], motion.velocities[begin:])


def _at_limits(problem: Problem, motion: Trajectory, arrive_from: float) -> Iterator[Trajectory]:
    """A motion strictly within its limits as fast as it may go, if it doesn't arrive too soon then; and as it is."""
    group, begin = problem.group, float(motion.times[0])
    jerks = cast(ChartRate, np.full(group.nv, np.inf)) if problem.jerk_limits is None else problem.jerk_limits
    rates = group.velocity_limits, group.acceleration_limits, jerks
    fast = at_limits(motion.times - begin, motion.positions, motion.velocities, *rates)
    if begin + fast.duration >= arrive_from:
        yield Trajectory(begin + fast.times, fast.positions, fast.velocities)
    yield motion
