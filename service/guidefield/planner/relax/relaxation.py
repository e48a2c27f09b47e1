"""Relax a path: take it to the middle of the free space and make it shorter, its ends and crossings kept.

The path becomes a chain of waypoints that descends

    J = (K - 1) / (2 L^2) sum |z_{k+1} - z_k|^2 + mean over samples of sum over points of w b(d / range)

by Newton's method on a block-tridiagonal system, with Levenberg's damping; L is the length at the start: long and
short paths weigh length against clearance alike. The barrier b is the field's near-surface law on the exact signed
distance d of points on the links, cut off smoothly at a range (`barrier`). Descending the plain potential
instead was measured to make paths worse: its far field outvotes the one gap that matters.

What comes out is a proposal: between the samples, and between the points, nobody has looked. The certificate judges.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from guidefield.errors import Status
from guidefield.kernels.relax.sampled_robot import SampledRobot
from guidefield.planner.motion.waypoints import cut, length_of
from guidefield.planner.relax.kept_waypoints import KeptWaypoints
from guidefield.planner.relax.sampled_robot import sampled_robot
from guidefield.planner.relax.settings import RELAXATION
from guidefield.planner.relax.waypoint_chain import Shape, WaypointChain
from guidefield.planner.task.problem import Problem
from guidefield.planner.task.trace import Note, PathRelaxed
from guidefield.read_only import ReadOnly
from guidefield.robot.model.spaces import ChartPoints
from guidefield.scene.distance_tables import distance_tables


class Outcome(enum.Enum):
    """How a relaxation ended."""

    CONVERGED = "converged"
    OUT_OF_ITERATIONS = "out of iterations"
    OUT_OF_TIME = "out of time"
    STOPPED = "stopped"
    NOTHING_TO_MOVE = "nothing to move"


_ENDINGS = {Status.TIMED_OUT: Outcome.OUT_OF_TIME, Status.PREEMPTED: Outcome.STOPPED}


@dataclass(frozen=True, eq=False)
class Relaxed(ReadOnly):
    """A relaxed path.

    Attributes:
        path: Chart points, shape (k, nv); the path as it was given where nothing was gained.
        crossings: By index of each guide plane, its index in `path`.
        iterations: How many steps were tried.
        energy_before: J of the path that was given, its waypoints spread evenly; 0 where nothing could move.
        energy_after: J of the relaxed path, with the same L.
        outcome: How it ended.
    """

    path: ChartPoints
    crossings: dict[int, int]
    iterations: int
    energy_before: float
    energy_after: float
    outcome: Outcome


def relax(
    problem: Problem,
    path: ChartPoints,
    crossings: Mapping[int, int],
    *,
    fixed: np.ndarray | None = None,
    segment: float = RELAXATION.segment,
) -> Relaxed:
    """Relax a path that was found, within the problem's budget and its number of steps.

    Both ends stay bit for bit, and so do waypoints that are fixed. A waypoint on a guide plane keeps its tip on the
    plane, inside the polygon; if it is an end, or on two planes at once, it stays. All others are spread evenly first.

    Args:
        problem: Robot, world, guide planes, budget and most steps.
        path: Chart points, shape (n, nv) [rad or m].
        crossings: By index of each guide plane, its index in `path`.
        fixed: Which waypoints stay besides the ends, shape (n,); None: none.
        segment: About how long segments are [rad or m]: the shorter, the less is overlooked between samples.
    """
    if length_of(path) == 0.0:
        return Relaxed(path, dict(crossings), 0, 0.0, 0.0, Outcome.NOTHING_TO_MOVE)
    kept = KeptWaypoints.of(problem, path, crossings, fixed)
    robot = sampled_robot(problem, distance_tables(problem.scene), path[kept.held])
    chain, shape, kept = _spread(problem, robot, path, kept, segment)
    iterations = (
        RELAXATION.most_iterations if problem.optimization_iterations is None else problem.optimization_iterations
    )
    length, before, tried = chain.length, shape, 0
    while True:
        shape, steps, outcome = _descend(problem, chain, shape, iterations - tried)
        tried += steps
        if outcome is not None:
            break
        chain, shape, kept = _spread(problem, robot, shape.path, kept, segment)
    problem.counters.iterations += tried
    if shape is before:
        return Relaxed(path, dict(crossings), tried, before.value, before.value, outcome)
    path, marks = _with_short_ends(shape.path, kept)
    relaxed = Relaxed(path, marks, tried, before.value, chain.energy(shape, length), outcome)
    _report(problem, relaxed)
    return relaxed


def _spread(
    problem: Problem, robot: SampledRobot, path: ChartPoints, kept: KeptWaypoints, segment: float
) -> tuple[WaypointChain, Shape, KeptWaypoints]:
    """The chain of a path's waypoints, spread evenly."""
    most = int(RELAXATION.most_segments * RELAXATION.segment / segment)
    segments = int(np.clip(np.ceil(length_of(path) / segment), RELAXATION.least_segments, most))
    points, kept = kept.spread(path, segments)
    chain = WaypointChain.of(problem, robot, points, kept.held, kept.on_planes)
    return chain, chain.at(points), kept


def _with_short_ends(path: ChartPoints, kept: KeptWaypoints) -> tuple[ChartPoints, dict[int, int]]:
    """A relaxed path with the segments next to waypoints that stay cut, and where the guide planes' crossings are."""
    stays = np.zeros(len(path), bool)
    stays[kept.held] = True
    points, indices = cut(path, stays[:-1] | stays[1:], RELAXATION.end_segment)
    return points, {plane: int(indices[index]) for plane, index in kept.marks.items()}


def _descend(
    problem: Problem, chain: WaypointChain, shape: Shape, iterations: int
) -> tuple[Shape, int, Outcome | None]:
    """Take steps as long as they bring something.

    Returns:
        The last shape, how many steps were tried, and how it ended; None: the path has shrunk.
    """
    damping, fall, settled = RELAXATION.first_damping, 0.0, 0
    for tried in range(iterations):
        if (spent := problem.budget.spent()) is not None:
            return shape, tried, _ENDINGS[spent]
        step = chain.step(shape, damping)
        moved = None if step is None else chain.moved(shape.path, step, 1.0 + RELAXATION.eagerness * fall)
        trial = None if moved is None else chain.at(moved)
        if trial is None or not trial.value < shape.value:
            damping, fall = 6.0 * damping, 0.0
            if damping > RELAXATION.hopeless_damping:
                return shape, tried + 1, Outcome.CONVERGED
            continue
        damping, fall = max(damping / 4.0, RELAXATION.least_damping), 1.0 - trial.value / shape.value
        shape = trial
        problem.tell(PathRelaxed(shape.path, shape.value))
        settled = settled + 1 if fall < RELAXATION.settled else 0
        if settled == 2:
            return shape, tried + 1, Outcome.CONVERGED
        if length_of(shape.path) < RELAXATION.shrunk * chain.length:
            return shape, tried + 1, None
    return shape, iterations, Outcome.OUT_OF_ITERATIONS


def _report(problem: Problem, relaxed: Relaxed) -> None:
    fell = f"the objective fell from {relaxed.energy_before:.3g} to {relaxed.energy_after:.3g}"
    problem.tell(Note(f"relaxed in {relaxed.iterations} steps ({relaxed.outcome.value}): {fell}"))
