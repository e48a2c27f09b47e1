"""Motions are measured within their time: where that is much it is done aside, and given up where time is up."""

from __future__ import annotations

from collections.abc import Sequence

from guidefield.aside import StoppedError, done_aside
from guidefield.planner.quality import Clearance, MotionInTime, clearance
from guidefield.planner.settings import MEASURING
from guidefield.planner.task.conditions import Budget, Conditions

MUCH, MUCH_AT_REST = 100_000, 1_000_000
"""Distances of fewer pairs at places are found within some milliseconds: among what moves, and by kernels."""

UNMEASURED = "time was up before distances were measured: `clearance` and `self_clearance` are left out"
"""Warning about motions that were not measured."""


def measured_in_time(motions: Sequence[tuple[MotionInTime, Conditions]], budget: Budget) -> list[Clearance] | None:
    """How far motions keep from everything, each under its conditions.

    Args:
        motions: The motions.
        budget: How long it may take; a little longer where distances are coarse then, as `clearance` does.

    Returns:
        Of each; None where time was up before.
    """

    def work() -> list[Clearance]:
        return [clearance(*one) for one in motions]

    much = MUCH if any(problem.scene.moves for _, problem in motions) else MUCH_AT_REST
    if sum(_distances(*one) for one in motions) < much:
        return work()
    try:
        return done_aside(work, budget.with_at_least(MEASURING.last), lambda: "the motion was measured")
    except StoppedError:
        return None


def _distances(motion: MotionInTime, problem: Conditions) -> int:
    """Of how many pairs at how many places distances may be looked at."""
    moments = sum(len(one.motion.times) for one in problem.scene.obstacles if one.motion is not None)
    return len(problem.world.pairs) * (MEASURING.most_samples // MEASURING.fewer + len(motion.times) + moments)
