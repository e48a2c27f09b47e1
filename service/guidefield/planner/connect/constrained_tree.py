"""Connecting under path constraints: the trees of any search, whose every step is projected on what has to be kept."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from guidefield.errors import Status
from guidefield.kernels.tree.path_constraints import KeptFrames, bring_back
from guidefield.planner.connect import tree_search
from guidefield.planner.connect.connect import Connection, why_not
from guidefield.planner.connect.settings import CONSTRAINED, TREE
from guidefield.planner.motion.waypoints import length_of
from guidefield.planner.task.problem import Problem
from guidefield.planner.task.trace import Step, StepKind, TreeGrown
from guidefield.robot.group.kept_frames import kept_frames
from guidefield.robot.group.path_constraints import ConstrainedFrames
from guidefield.robot.model.spaces import ChartPoint, ChartPoints


@dataclass(frozen=True, eq=False)
class Keeper:
    """Keeps configurations within path constraints."""

    problem: Problem
    frames: ConstrainedFrames

    def brought_back(self, z: ChartPoint) -> ChartPoint | None:
        """The chart point next to z (nv,), within limits, that keeps the constraints with room; None if there is none.

        Newton's steps of least length on the numbers that are too large.
        """
        there: ChartPoint = np.array(z)
        return there if bring_back(self.tables, CONSTRAINED.room, CONSTRAINED.corrections, there) else None

    @property
    def tables(self) -> KeptFrames:
        """The constraints as the kernels want them."""
        return kept_frames(self.frames)


def connect_constrained(
    problem: Problem, keeper: Keeper, z_start: ChartPoint, goals: ChartPoints, rng: np.random.Generator
) -> Connection:
    """Find a motion within path constraints from a chart point to one of several, free by samples.

    Args:
        z_start: Chart point, shape (nv,), free.
        goals: Chart points, shape (m, nv), free.
    """
    roots = np.array([problem.group.unwrapped(goal, z_start) for goal in goals])
    found = tree_search.grow(
        problem.lanes, z_start[None], roots, TREE.resolution, 0.0, rng, problem.deadline,
        most_iterations=CONSTRAINED.most_iterations, frames=keeper.tables,
    )  # fmt: skip
    problem.counters.iterations += found.iterations
    problem.counters.collision_checks += found.motions
    problem.tell(TreeGrown(found.trees))
    if found.path is None:
        status = problem.deadline.status()
        message = why_not(found, len(goals), in_time=status is not None)
        return Connection(status or Status.PLANNING_FAILED, f"within the path constraints {message}", z_start[None])
    path = _shorten(problem, keeper, found.path, rng)
    for z in path[1:]:
        problem.tell(Step(StepKind.TREE, problem.group.from_chart(z), "found within the path constraints"))
    return Connection(Status.SUCCESS, f"found within the path constraints in {found.iterations} iterations", path)


def _shorten(problem: Problem, keeper: Keeper, path: ChartPoints, rng: np.random.Generator) -> ChartPoints:
    """The path with detours between random waypoints left out where a walk leads straight across."""
    units = problem.group.units
    for _ in range(CONSTRAINED.shortcuts):
        if len(path) < 4 or problem.deadline.expired():
            break
        first, last = np.sort(rng.choice(len(path), 2, replace=False))
        ends = path[first], path[last]
        way = tree_search.grow(
            problem.lanes, ends[0][None], ends[1][None], TREE.resolution, 0.0, rng, problem.deadline,
            most_iterations=0, frames=keeper.tables,
        ).path  # fmt: skip
        if way is None or np.abs(way[-1] - ends[1]).max() > 1e-9:  # not there, or there the other way round
            continue
        if length_of(way, units) < length_of(path[first : last + 1], units) - 1e-9:
            path = np.concatenate([path[:first], ends[0][None], way[1:-1], path[last:]])
    return path
