"""Relax a path: take it to the middle of the free space and make it shorter, its ends and crossings kept.

The path becomes a chain of waypoints that descends

    J = lambda (K - 1) / 2 sum |z_{k+1} - z_k|^2 + mean over samples of sum over points of w b(d / range)

by Newton's method on a block-tridiagonal system, with Levenberg's damping. The barrier b is the field's near-surface
law on the exact signed distance d of points on the links, cut off smoothly at a range (kernels/barrier.py). Descending
the plain potential instead was measured to make paths worse: its far field outvotes the one gap that matters.

What comes out is a proposal: between the samples, and between the points, nobody has looked. The certificate judges.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from guidefield.errors import Status
from guidefield.planner.chain import Chain, Shape
from guidefield.planner.plane_crossing import PlaneCrossing
from guidefield.planner.problem import Problem
from guidefield.planner.trace import Note, Step
from guidefield.planner.waypoints import respaced

SEGMENT = 0.14
"""Length of a segment [rad or m]."""

LEAST_SEGMENTS, MOST_SEGMENTS = 16, 96

MOST_ITERATIONS = 60

SETTLED = 1e-2
"""A step that lowers J by less than this share brings little; two in a row end the relaxation."""

EAGERNESS = 2.0
"""A step is taken 1 + this times the share by which the last one lowered J.

Next to a pole Newton's steps are too short: for 1/d^3 each brings a quarter of the distance only.
"""

FIRST_DAMPING, LEAST_DAMPING, HOPELESS_DAMPING = 1.0, 1e-6, 1e8
"""Of a step, in units of the stretch energy's stiffness."""


class Outcome(enum.StrEnum):
    """How a relaxation ended."""

    CONVERGED = "converged"
    OUT_OF_ITERATIONS = "out of iterations"
    OUT_OF_TIME = "out of time"
    STOPPED = "stopped"
    NOTHING_TO_MOVE = "nothing to move"


_ENDINGS = {Status.TIMED_OUT: Outcome.OUT_OF_TIME, Status.PREEMPTED: Outcome.STOPPED}


@dataclass(frozen=True, eq=False)
class Relaxed:
    """A relaxed path.

    Attributes:
        path: Chart points, shape (k, nv); the path as it was given where nothing was gained.
        crossings: By index of each guide plane, its index in `path`.
        iterations: How many steps were tried.
        energy_before: J of the path that was given, its waypoints spread evenly; 0 where nothing could move.
        energy_after: J of the relaxed path.
        outcome: How it ended.
    """

    path: np.ndarray
    crossings: dict[int, int]
    iterations: int
    energy_before: float
    energy_after: float
    outcome: Outcome


def relax(
    problem: Problem,
    path: np.ndarray,
    crossings: Mapping[int, int],
    *,
    fixed: np.ndarray | None = None,
    iterations: int = MOST_ITERATIONS,
) -> Relaxed:
    """Relax a path that was found, within the problem's budget.

    Both ends stay bit for bit, and so do waypoints that are fixed. A waypoint on a guide plane keeps its tip on the
    plane, inside the polygon; if it is an end, or on two planes at once, it stays. All others are spread evenly first.

    Args:
        problem: Robot, world, guide planes and budget.
        path: Chart points, shape (n, nv).
        crossings: By index of each guide plane, its index in `path`.
        fixed: Which waypoints stay besides the ends, shape (n,); None: none.
        iterations: Most steps that are tried.
    """
    held = _held(path, crossings, fixed)
    length = float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
    if length == 0.0:
        return Relaxed(path, dict(crossings), 0, 0.0, 0.0, Outcome.NOTHING_TO_MOVE)
    kept = np.array(sorted(held | set(crossings.values())))
    segments = int(np.clip(np.ceil(length / SEGMENT), LEAST_SEGMENTS, MOST_SEGMENTS))
    points, indices = respaced(path, kept, segments)
    placed = dict(zip(kept.tolist(), indices.tolist(), strict=True))
    on_planes = {
        placed[index]: PlaneCrossing.through(problem, problem.guide_planes[plane], path[index])
        for plane, index in crossings.items()
        if index not in held
    }
    chain = Chain.of(problem, points, sorted(placed[index] for index in held), on_planes)
    first = chain.at(points)
    last, tried, outcome = _descend(problem, chain, first, iterations)
    problem.counters.iterations += tried
    if last is first:
        return Relaxed(path, dict(crossings), tried, first.value, first.value, outcome)
    _report(problem, first, last, tried, outcome)
    marks = {plane: placed[index] for plane, index in crossings.items()}
    return Relaxed(last.path, marks, tried, first.value, last.value, outcome)


def _held(path: np.ndarray, crossings: Mapping[int, int], fixed: np.ndarray | None) -> set[int]:
    """Waypoints that stay: the ends, those that are fixed, and those on two planes at once."""
    held = {0, len(path) - 1}
    if fixed is not None:
        held |= set(np.flatnonzero(fixed).tolist())
    at = list(crossings.values())
    return held | {index for index in at if at.count(index) > 1}


def _descend(problem: Problem, chain: Chain, shape: Shape, iterations: int) -> tuple[Shape, int, Outcome]:
    """Take steps as long as they bring something; the best shape, the steps tried, how it ended."""
    damping, fall, settled = FIRST_DAMPING, 0.0, 0
    for tried in range(iterations):
        if (spent := problem.budget.spent()) is not None:
            return shape, tried, _ENDINGS[spent]
        step = chain.step(shape, damping)
        moved = None if step is None else chain.moved(shape.path, step, 1.0 + EAGERNESS * fall)
        trial = None if moved is None else chain.at(moved)
        if trial is None or not trial.value < shape.value:
            damping, fall = 6.0 * damping, 0.0
            if damping > HOPELESS_DAMPING:
                return shape, tried + 1, Outcome.CONVERGED
            continue
        damping, fall = max(damping / 4.0, LEAST_DAMPING), 1.0 - trial.value / shape.value
        shape = trial
        settled = settled + 1 if fall < SETTLED else 0
        if settled == 2:
            return shape, tried + 1, Outcome.CONVERGED
    return shape, iterations, Outcome.OUT_OF_ITERATIONS


def _report(problem: Problem, first: Shape, last: Shape, tried: int, outcome: Outcome) -> None:
    text = f"relaxed in {tried} steps ({outcome}): the objective fell from {first.value:.3g} to {last.value:.3g}"
    problem.tell(Note(text))
    for z in last.path:
        problem.tell(Step("relax", problem.group.from_chart(z), "relaxed"))
