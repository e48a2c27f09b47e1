"""Connecting under path constraints: trees whose every step is projected on what has to be kept.

After CBiRRT (Berenson et al., ICRA 2009): a step towards a sample is corrected by Newton's method until the constraints
hold with some room to spare, so that a thin set of configurations is walked along and not waited for.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from guidefield.errors import Status
from guidefield.planner.connect.connect import Connection
from guidefield.planner.connect.settings import CONSTRAINED, TREE
from guidefield.planner.connect.tree import Tree
from guidefield.planner.motion.waypoints import length_of
from guidefield.planner.task.problem import Problem
from guidefield.planner.task.trace import Step, StepKind
from guidefield.robot.group.path_constraints import ConstrainedFrames
from guidefield.robot.model.spaces import ChartPoint, ChartPoints


@dataclass(frozen=True, eq=False)
class Keeper:
    """Keeps configurations within path constraints; for the relaxation it holds a waypoint as a crossing does.

    Attributes:
        problem: Robot and limits.
        frames: The constraints.
    """

    problem: Problem
    frames: ConstrainedFrames

    def held_directions(self, z: ChartPoint, descent: ChartPoint) -> np.ndarray:
        """Directions of the chart in which a descent would leave the constraints.

        Args:
            z: Where it is, a chart point, shape (nv,).
            descent: Where it wants to go, shape (nv,).

        Returns:
            Orthonormal rows, shape (r, nv).
        """
        values, rows = self.frames.values_and_rows(z)
        leaving = rows[(values >= CONSTRAINED.room * self.frames.limits * (1.0 - 1e-3)) & (rows @ descent > 0.0)]
        _, strengths, directions = np.linalg.svd(leaving, full_matrices=False)
        held: np.ndarray = directions[strengths > 1e-9]
        return held

    def brought_back(self, z: ChartPoint) -> ChartPoint | None:
        """The chart point next to z (nv,), within limits, that keeps the constraints with room; None if there is none.

        Newton's steps of least length on the numbers that are too large.
        """
        group, aim = self.problem.group, CONSTRAINED.room * self.frames.limits
        for _ in range(CONSTRAINED.corrections):
            values, rows = self.frames.values_and_rows(z)
            excess = values - aim
            if (excess <= 1e-6 * aim).all():
                return z
            much = excess > 0.0
            A = rows[much]
            step = A.T @ np.linalg.solve(A @ A.T + 1e-12 * np.eye(len(A)), excess[much])
            z = np.clip(z - step, group.lower, group.upper)
        return None

    def keeps(self, z: ChartPoint) -> bool:
        """Whether a chart point, shape (nv,), keeps the constraints."""
        return bool((self.frames.values(z) <= self.frames.limits).all())

    def apart(self, one: ChartPoint, other: ChartPoint) -> float:
        """How far apart two chart points are by the group's metric, each of shape (nv,), with no turn taken back."""
        return float(np.linalg.norm((other - one) / self.problem.group.units))

    def steps(self, origin: ChartPoint, target: ChartPoint) -> list[ChartPoint]:
        """Free chart points, a stride apart, from one towards another, as far as they come nearer to it.

        Args:
            origin: Where they start, shape (nv,); not among them.
            target: Where they lead, shape (nv,); an angle that wraps goes there the short way round.

        Returns:
            Each of shape (nv,), angles unwrapped from the origin on.
        """
        taken, here = [], origin
        target = self.problem.group.unwrapped(target, origin)
        while (left := self.apart(here, target)) > 1e-9:
            if left <= CONSTRAINED.stride:
                there: ChartPoint | None = target
            else:
                there = self.brought_back(here + (target - here) * (CONSTRAINED.stride / left))
            least = CONSTRAINED.least_gain * min(CONSTRAINED.stride, left)
            if there is None or left - self.apart(there, target) < least:
                break
            if self.apart(here, there) > 2.0 * CONSTRAINED.stride or not self._free(here, there):
                break
            taken.append(there)
            here = there
        return taken

    def _free(self, here: ChartPoint, there: ChartPoint) -> bool:
        if not self.keeps(there) or not self.keeps(0.5 * (here + there)):
            return False
        self.problem.counters.collision_checks += 1
        return self.problem.lanes.free_until(np.array([here, there]), TREE.resolution) == 1


def connect_constrained(
    problem: Problem, keeper: Keeper, z_start: ChartPoint, goals: ChartPoints, rng: np.random.Generator
) -> Connection:
    """Find a motion within path constraints from a chart point to one of several, free by samples.

    Args:
        problem: Robot, world and budget.
        keeper: The constraints; start and goals keep them.
        z_start: Chart point, shape (nv,), free.
        goals: Chart points, shape (m, nv), free.
        rng: Randomness.
    """
    group = problem.group
    near = np.array([group.unwrapped(goal, z_start) for goal in goals])
    trees = (Tree(group, z_start[None]), Tree(group, near))
    for iteration in range(CONSTRAINED.most_iterations):
        if (spent := problem.budget.spent()) is not None:
            return Connection(spent, "no connection within the path constraints was found in time", z_start[None])
        problem.counters.iterations += 1
        active = 0 if trees[0].size <= trees[1].size else 1
        growing, other = trees[active], trees[1 - active]
        target = near[iteration % len(near)] if iteration < len(near) else group.chart(group.random(rng))
        node = growing.nearest(target)
        reached = _grown(growing, node, keeper.steps(growing.point(node).copy(), target))
        point = growing.point(reached).copy()
        node = other.nearest(point)
        met = _grown(other, node, keeper.steps(other.point(node).copy(), point))
        if keeper.apart(point, group.unwrapped(other.point(met), point)) > 1e-9:
            continue
        branches = (growing.branch(reached), other.branch(met))
        first, second = branches if active == 0 else branches[::-1]
        # the second branch on from where the first ends: whole turns away where an angle went round
        turns = group.unwrapped(second[-1], first[-1]) - second[-1]
        path = _shortened(keeper, np.array([*first, *(z + turns for z in second[-2::-1])]), rng)
        for z in path[1:]:
            problem.tell(Step(StepKind.TREE, group.from_chart(z), "found within the path constraints"))
        return Connection(Status.SUCCESS, f"found within the path constraints in {iteration + 1} iterations", path)
    return Connection(Status.PLANNING_FAILED, "no connection within the path constraints was found", z_start[None])


def _grown(tree: Tree, node: int, steps: list[ChartPoint]) -> int:
    """Add steps to a tree, one after the other; the last node."""
    for step in steps:
        node = tree.add(step, node)
    return node


def _shortened(keeper: Keeper, path: ChartPoints, rng: np.random.Generator) -> ChartPoints:
    """The path with detours between random waypoints left out where steps lead across."""
    units = keeper.problem.group.units
    for _ in range(CONSTRAINED.shortcuts):
        if len(path) < 4 or keeper.problem.budget.spent():
            break
        first, last = np.sort(rng.choice(len(path), 2, replace=False))
        across = keeper.steps(path[first], path[last])
        if not across or keeper.apart(across[-1], path[last]) > 1e-9:  # not there, or there the other way round
            continue
        way = np.array([path[first], *across[:-1], path[last]])
        if length_of(way, units) < length_of(path[first : last + 1], units) - 1e-9:
            path = np.concatenate([path[:first], way, path[last + 1 :]])
    return path
