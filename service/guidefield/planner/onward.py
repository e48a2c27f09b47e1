"""Motions that have begun among obstacles that move, and go on: what comes after is planned from where they end."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from guidefield.planner.finish import Finished
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.start_enclosure import enclosed_start
from guidefield.planner.task.problem import Problem
from guidefield.planner.task.stages import Stages
from guidefield.prove.certificate import certify_timed


def gone_on(
    problem: Problem,
    begun: Trajectory,
    go_on: Callable[[Problem], Finished],
    around: Callable[[Trajectory], Trajectory],
    stages: Stages,
    crossings: Mapping[int, int],
) -> Finished:
    """The motion that has begun and what follows it, judged in time as one.

    Args:
        problem: Robot, obstacles and what to keep.
        begun: The motion so far, from time 0 on, in the end at rest.
        go_on: Plans what follows, from where the motion ends; time 0 is then.
        around: Makes the whole of what follows.
        stages: Where time is counted.
        crossings: By index of each guide plane that was reached by then, the index of its knot.

    Returns:
        The whole; where what follows failed, the motion so far, judged, and why.
    """
    end = float(begun.times[-1])
    rest = go_on(problem.since(end, problem.group.from_chart(begun.positions[-1])))
    whole = begun if rest.trajectory is None else around(rest.trajectory)
    with stages.entered("certify", "the whole motion, in time, between samples too") as stage:
        pieces, times = whole.bezier(), whole.piece_times()
        verdict = enclosed_start(problem, pieces[0, 0]) or certify_timed(
            problem.world, pieces, times, problem.min_clearance, deadline=problem.deadline
        )
        problem.counters.collision_checks += verdict.evaluations
        stage.outcome = verdict.reason.value
    if rest.trajectory is None:
        return Finished(verdict, begun.positions, crossings, failure=rest.failure, warnings=rest.warnings)
    path = np.concatenate([whole.positions[: len(begun.positions)], rest.path[1:]])
    return Finished(verdict, path, crossings, whole, warnings=rest.warnings)
