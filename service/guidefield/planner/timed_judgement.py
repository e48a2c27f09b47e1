"""The certificate in time about a motion among obstacles that move, and what comes of one that a guide found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from guidefield.deadline import UNLIMITED, Deadline
from guidefield.planner.finish import LAST_JUDGEMENT, Finished
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.start_enclosure import enclosed_start
from guidefield.planner.task.problem import Problem
from guidefield.planner.task.stages import Stages
from guidefield.planner.timed_guide import TimedPath
from guidefield.prove.certificate import certify_timed
from guidefield.prove.constraint_certificate import certify_constraints
from guidefield.prove.verdict import Verdict


def judged_in_time(problem: Problem, motion: Trajectory, deadline: Deadline | None = None) -> Verdict:
    """Whether a motion is free of what rests and what moves, and keeps the path constraints.

    Args:
        problem: Robot, obstacles and constraints.
        motion: From time 0 on.
        deadline: Ends the judgement. None: the problem's.
    """
    deadline = problem.deadline if deadline is None else deadline
    verdict, pieces = _free_in_time(problem, motion, deadline), motion.bezier()
    if verdict.free and problem.path_constraints:
        kept = certify_constraints(problem.constrained_frames, problem.world.bodies.turns, pieces, deadline)
        verdict = replace(kept, evaluations=verdict.evaluations + kept.evaluations)
    return verdict


def finish_timed(problem: Problem, found: TimedPath, stages: Stages) -> Finished:
    """Judge a guided motion among obstacles that move, whose schedule is the trajectory's.

    Args:
        problem: Robot, world, obstacles and path constraints.
        found: The motion, or how far it got: then only whether that is free.
        stages: Where time is counted.
    """
    trajectory, failure = found.trajectory(), found.failure
    whole = "on the exact geometry, in time, between samples too"
    with stages.entered("certify", whole if failure is None else "the motion as far as it got, in time") as stage:
        if failure is None:
            verdict = judged_in_time(problem, trajectory, problem.deadline.at_least(LAST_JUDGEMENT))
        else:
            verdict = _free_in_time(problem, trajectory, UNLIMITED)
        stage.outcome = verdict.reason.value
    if failure is not None:
        return Finished(verdict, np.array(found.points), found.crossings, failure=failure)
    problem.counters.collision_checks += verdict.evaluations
    return Finished(verdict, trajectory.positions, found.knots, trajectory)


def _free_in_time(problem: Problem, motion: Trajectory, deadline: Deadline) -> Verdict:
    pieces, times = motion.bezier(), motion.piece_times()
    if (inside := enclosed_start(problem, pieces[0, 0], float(times[0]))) is not None:
        return inside
    return certify_timed(problem.world, pieces, times, problem.min_clearance, deadline=deadline)
