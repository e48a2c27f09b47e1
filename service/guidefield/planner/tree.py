"""Bidirectional tree search (RRT-Connect, Kuffner and LaValle 2000) in the chart of a planning group."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from guidefield.planner.problem import Budget
from guidefield.robot.chart import ANGLE
from guidefield.robot.group import PlanningGroup

RANGE = 1.0
"""Longest extension of a tree [rad or m]."""
MOST_ITERATIONS = 100_000

Valid = Callable[[np.ndarray, np.ndarray], bool]
"""Whether the straight motion between two chart points (nv,) may be taken."""


@dataclass(frozen=True, eq=False)
class Found:
    """What a search came to.

    Attributes:
        path: Chart points from a start to a goal, angles unwrapped along the way; None if there is none.
        iterations: Samples drawn.
        grown: The trees from the starts and from the goals.
    """

    path: list[np.ndarray] | None
    iterations: int
    grown: tuple[Tree, Tree]

    def trees(self) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
        """Of both trees, chart points of the nodes, shape (n, nv), and each one's parent, shape (n,); -1 for a root."""
        return tuple(tree.nodes() for tree in self.grown)


class Tree:
    """A tree of chart points; grows its arrays by doubling."""

    def __init__(self, roots: np.ndarray) -> None:
        self._points = np.empty((max(64, 2 * len(roots)), roots.shape[1]))
        self._parents = np.full(len(self._points), -1)
        self._points[: len(roots)] = roots
        self.size = len(roots)

    def add(self, point: np.ndarray, parent: int) -> int:
        """Add a chart point, shape (nv,), as a node below another one; its index."""
        if self.size == len(self._points):
            self._points = np.concatenate([self._points, np.empty_like(self._points)])
            self._parents = np.concatenate([self._parents, np.full(self.size, -1)])
        self._points[self.size], self._parents[self.size] = point, parent
        self.size += 1
        return self.size - 1

    def nearest(self, point: np.ndarray, period: np.ndarray) -> int:
        """Index of the node nearest to a point.

        Args:
            point: Chart point, shape (nv,) [rad or m].
            period: 2 pi for angles that wrap, else infinite, shape (nv,).
        """
        apart = self._points[: self.size] - point
        wraps = np.isfinite(period)
        apart[:, wraps] -= period[wraps] * np.round(apart[:, wraps] / period[wraps])
        return int(np.argmin(np.einsum("ij,ij->i", apart, apart)))

    def nodes(self) -> tuple[np.ndarray, np.ndarray]:
        """Chart points (n, nv) and the indices of their parents (n,), -1 for a root."""
        return self._points[: self.size].copy(), self._parents[: self.size].copy()

    def point(self, index: int) -> np.ndarray:
        """The chart point of a node, shape (nv,)."""
        point: np.ndarray = self._points[index]
        return point

    def branch(self, index: int) -> list[np.ndarray]:
        """Chart points, each of shape (nv,), from the root to a node."""
        points = []
        while index >= 0:
            points.append(self._points[index].copy())
            index = int(self._parents[index])
        return points[::-1]


def grow(
    group: PlanningGroup, starts: np.ndarray, goals: np.ndarray, valid: Valid, rng: np.random.Generator, budget: Budget
) -> Found:
    """Grow two trees towards each other until they meet.

    Args:
        group: Joints and limits.
        starts: Roots of the one tree, shape (k, nv).
        goals: Roots of the other, shape (m, nv).
        valid: Judge of straight motions.
        rng: Randomness.
        budget: How long.
    """
    period = np.full(group.nv, np.inf)
    for joint in group.joints:
        if joint.kind in ANGLE:
            period[joint.idx_v + ANGLE[joint.kind]] = 2.0 * np.pi
    trees = (Tree(starts), Tree(goals))
    for iteration in range(1, MOST_ITERATIONS + 1):
        if budget.spent():
            return Found(None, iteration, trees)
        active = 0 if trees[0].size <= trees[1].size else 1  # balanced: the smaller tree grows
        growing, other = trees[active], trees[1 - active]
        sample = group.chart(group.random(rng))
        reached = _extend(growing, sample, period, valid)
        if reached is None:
            continue
        met = _connect(other, growing.point(reached), period, valid)
        if met is None:
            continue
        branches = (growing.branch(reached), other.branch(met))
        first, second = branches if active == 0 else branches[::-1]
        return Found(_joined(group, first, second), iteration, trees)
    return Found(None, MOST_ITERATIONS, trees)


def _extend(tree: Tree, target: np.ndarray, period: np.ndarray, valid: Valid) -> int | None:
    """Add the point at most `RANGE` from the nearest node towards a target; None if the way there is not free."""
    nearest = tree.nearest(target, period)
    origin = tree.point(nearest).copy()
    way = _way(origin, target, period)
    length = float(np.linalg.norm(way))
    reached = origin + way * min(1.0, RANGE / max(length, 1e-12))
    return tree.add(reached, nearest) if valid(origin, reached) else None


def _connect(tree: Tree, target: np.ndarray, period: np.ndarray, valid: Valid) -> int | None:
    """Go on towards a target as far as the way is free; the node at the target, or None."""
    node = tree.nearest(target, period)
    while True:
        origin = tree.point(node).copy()
        way = _way(origin, target, period)
        length = float(np.linalg.norm(way))
        reached = origin + way * min(1.0, RANGE / max(length, 1e-12))
        if not valid(origin, reached):
            return None
        node = tree.add(reached, node)
        if length <= RANGE:
            return node


def _way(origin: np.ndarray, target: np.ndarray, period: np.ndarray) -> np.ndarray:
    """From one chart point to another, the short way round for angles that wrap."""
    way: np.ndarray = target - origin
    wraps = np.isfinite(period)
    way[wraps] -= period[wraps] * np.round(way[wraps] / period[wraps])
    return way


def _joined(group: PlanningGroup, first: list[np.ndarray], second: list[np.ndarray]) -> list[np.ndarray]:
    """The branch from the start and that from the goal as one path; whole turns are added to the second."""
    path = list(first)
    for point in second[-2::-1]:
        path.append(group.unwrapped(point, path[-1]))
    return path
