"""A tree of chart points, of joints that turn or slide."""

from __future__ import annotations

import numpy as np

from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.model.spaces import ChartPoint, ChartPoints


class Tree:
    """A tree of a group's chart points; grows its arrays by doubling.

    Distances are by the group's metric, the short way round where an angle wraps.
    """

    def __init__(self, group: PlanningGroup, roots: ChartPoints) -> None:
        self._units, self._periods = group.units, group.periods
        self._points = np.empty((max(64, 2 * len(roots)), roots.shape[1]))
        self._parents = np.full(len(self._points), -1)
        self._points[: len(roots)] = roots
        self.size = len(roots)

    def add(self, point: ChartPoint, parent: int) -> int:
        """Add a chart point, shape (nv,), as a node below another one; its index."""
        if self.size == len(self._points):
            self._points = np.concatenate([self._points, np.empty_like(self._points)])
            self._parents = np.concatenate([self._parents, np.full(self.size, -1)])
        self._points[self.size], self._parents[self.size] = point, parent
        self.size += 1
        return self.size - 1

    def nearest(self, point: ChartPoint) -> int:
        """Index of the node nearest to a chart point, shape (nv,)."""
        apart = self._points[: self.size] - point
        wraps = self._periods > 0.0
        apart[:, wraps] -= self._periods[wraps] * np.round(apart[:, wraps] / self._periods[wraps])
        apart /= self._units
        return int(np.argmin(np.einsum("ij,ij->i", apart, apart)))

    def point(self, index: int) -> ChartPoint:
        """The chart point of a node, shape (nv,)."""
        point: ChartPoint = self._points[index]
        return point

    def branch(self, index: int) -> list[ChartPoint]:
        """Chart points, each of shape (nv,), from the root to a node."""
        points = []
        while index >= 0:
            points.append(self._points[index].copy())
            index = int(self._parents[index])
        return points[::-1]
