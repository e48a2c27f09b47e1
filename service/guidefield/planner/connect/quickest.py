"""Ways to the goal that is reached soonest: a straight motion or a tree for each in turn, scored by estimated time.

A straight motion along d takes at least max_j |d_j| / V_j, with the velocity limits V. A way of several straight pieces
is scored between what it takes where all joints have to wait for the slowest on each piece, and where none has to.
Where not time alone counts, a score has a share of the way's length besides. Goals are tried in the order of their
straight ways' scores; the search ends at the first whose own is no better than the best way that was found.

Several ways are left, except where clearance counts most: which is the quickest shows when they are optimised. Where
time alone counts there are more of them, and more rounds of trees while the best score is far from the least bound.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from guidefield.planner.connect import tree_search
from guidefield.planner.connect.settings import QUICKEST, TREE
from guidefield.planner.task.problem import Objective, Problem
from guidefield.planner.task.trace import TreeGrown
from guidefield.read_only import ReadOnly
from guidefield.robot.model.size import MARGIN
from guidefield.robot.model.spaces import ChartPoint, ChartPoints, ChartRate


@dataclass(frozen=True, eq=False)
class QuickestWay(ReadOnly):
    """The way to one of several goals that is estimated to take the least time.

    Attributes:
        path: Chart points, shape (n, nv), free at samples.
        others: The next best, shape (n, nv) each; none where clearance counts most.
    """

    path: ChartPoints
    others: tuple[ChartPoints, ...]
    tried: int
    iterations: int


def quickest_way(
    problem: Problem, z_start: ChartPoint, goals: ChartPoints, rng: np.random.Generator
) -> QuickestWay | None:
    """Look for ways to several goals, each by itself.

    Args:
        z_start: Chart point, shape (nv,), free.
        goals: Chart points, shape (m, nv), free, whole turns chosen next to the start.

    Returns:
        The best; None where none of them is reached with a few motions, so that all have to be tried together.
    """
    search = _Search(problem, z_start, goals, rng)
    bounds = search.straight_scores()
    order = np.argsort(bounds, kind="stable")[: QUICKEST.goals].tolist()
    for round_ in range(1 + (QUICKEST.rounds if problem.objective is Objective.TIME else 0)):
        if round_ and search.least <= QUICKEST.enough * bounds[order[0]]:
            break
        for index in order:
            if bounds[index] >= search.least or problem.deadline.expired():
                break
            search.try_goal(index)
    if not search.found:
        return None
    ways = {Objective.TIME: QUICKEST.ways, Objective.BALANCED: QUICKEST.few_ways, Objective.CLEARANCE: 1}
    best, *others = sorted(search.found, key=lambda scored: scored[0])[: ways[problem.objective]]
    return QuickestWay(best[1], tuple(way for _, way in others), len(search.straight), search.iterations)


class _Search:
    """The ways that were found so far, each with its score."""

    def __init__(self, problem: Problem, z_start: ChartPoint, goals: ChartPoints, rng: np.random.Generator) -> None:
        self._problem, self._start, self._goals, self._rng = problem, z_start, goals, rng
        self.found: list[tuple[float, ChartPoints]] = []
        self.straight: dict[int, bool] = {}
        self.iterations = 0

    @property
    def least(self) -> float:
        """The best score [s]; infinite where no way was found."""
        return min((score for score, _ in self.found), default=np.inf)

    def score(self, way: ChartPoints) -> float:
        """What a way (n, nv) counts [s]: its estimated time, and a share of its length unless time alone counts."""
        limits = self._problem.group.velocity_limits
        score = estimated_time(way, limits)
        if self._problem.objective is not Objective.TIME:
            score += QUICKEST.length * float(np.linalg.norm(np.diff(way, axis=0) / limits, axis=1).sum())
        return score

    def straight_scores(self) -> np.ndarray:
        """What the straight way to each goal counts, (m,) [s]."""
        ways = (self._goals - self._start) / self._problem.group.velocity_limits
        scores: np.ndarray = np.abs(ways).max(axis=1)
        if self._problem.objective is not Objective.TIME:
            scores += QUICKEST.length * np.linalg.norm(ways, axis=1)
        return scores

    def try_goal(self, index: int) -> None:
        """Look for a way to a goal; for another one by another tree, unless the straight one is free."""
        problem, goal = self._problem, self._goals[index]
        lanes, clearance = problem.lanes, problem.min_clearance
        way = np.array([self._start, goal])
        if self.straight.get(index, False):
            return
        if index not in self.straight:
            self.straight[index] = bool(lanes.free_until(way, TREE.resolution, clearance))
        if not self.straight[index]:
            roots = np.concatenate([goal[None], problem.group.turned_otherwise(goal)])
            found = tree_search.grow(
                lanes,
                self._start[None],
                roots,
                TREE.resolution,
                clearance,
                self._rng,
                problem.deadline,
                most_motions=QUICKEST.motions,
            )
            self.iterations += found.iterations
            problem.counters.iterations += found.iterations
            problem.counters.collision_checks += found.motions
            problem.tell(TreeGrown(found.trees))
            if found.path is None:
                return
            way = lanes.shorten(found.path, TREE.resolution, clearance + MARGIN * problem.group.size)
        self.found.append((self.score(way), way))


def estimated_time(path: ChartPoints, velocity_limits: ChartRate) -> float:
    """About how long a path takes once it is optimised, but for speeding up and slowing down [s].

    Args:
        path: Chart points, shape (n, nv) [rad or m].
        velocity_limits: Shape (nv,) [rad/s or m/s].
    """
    times = np.abs(np.diff(path, axis=0)) / velocity_limits
    return 0.5 * float(times.max(axis=1).sum() + times.sum(axis=0).max())
