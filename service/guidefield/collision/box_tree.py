"""A tree of boxes along the world's axes: those that overlap others are found without looking at all of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

CHILDREN = 16
"""Boxes behind one box of the next level."""

_BITS = 16
"""Bits of one coordinate of a place on the curve along which boxes are sorted."""


@dataclass(frozen=True, eq=False)
class BoxTree:
    """Boxes in the order of their centres along a Morton curve, and above them boxes about every `CHILDREN` of them.

    Attributes:
        order: Index of each box as it was given, in the order in which the tree has them, shape (n,).
        levels: Lower and upper corners, coordinate by coordinate, each of shape (6, m) [m]: the boxes themselves, then
            those about them, up to a level of `CHILDREN` at most.
    """

    order: np.ndarray
    levels: tuple[np.ndarray, ...]

    @classmethod
    def of(cls, low: np.ndarray, high: np.ndarray) -> BoxTree:
        """Sort boxes.

        Args:
            low: Lower corners, shape (n, 3), finite [m].
            high: Upper corners, shape (n, 3) [m].
        """
        order = np.argsort(_places_on_curve(0.5 * (low + high)), kind="stable")
        levels = [np.ascontiguousarray(np.hstack([low, high])[order].T)]
        while levels[-1].shape[1] > CHILDREN:
            below = levels[-1]
            starts = np.arange(0, below.shape[1], CHILDREN)
            corners = np.minimum.reduceat(below[:3], starts, axis=1), np.maximum.reduceat(below[3:], starts, axis=1)
            levels.append(np.vstack(corners))
        for array in (order, *levels):
            array.setflags(write=False)
        return cls(order, tuple(levels))

    def overlapping(self, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Which of the boxes overlap which of others; boxes that touch do.

        Args:
            low: Lower corners of the others, shape (q, 3) [m].
            high: Upper corners, shape (q, 3) [m].

        Returns:
            Index of one of the others and index of a box as it was given, both of shape (k,), in this order.
        """
        low, high = np.ascontiguousarray(low.T), np.ascontiguousarray(high.T)
        top = self.levels[-1].shape[1]
        asked, node = np.repeat(np.arange(low.shape[1]), top), np.tile(np.arange(top), low.shape[1])
        for level, below in zip(self.levels[::-1], (*self.levels[-2::-1], None), strict=True):
            for axis in range(3):  # one after the other: few are left after the first
                near = (level[axis][node] <= high[axis][asked]) & (level[3 + axis][node] >= low[axis][asked])
                asked, node = asked[near], node[near]
            if below is not None:
                node = (CHILDREN * node[:, None] + np.arange(CHILDREN)).ravel()
                asked = np.repeat(asked, CHILDREN)
                there = node < below.shape[1]
                asked, node = asked[there], node[there]
        found = self.order[node]
        sorted_ = np.lexsort((found, asked))
        return asked[sorted_], found[sorted_]


def _places_on_curve(points: np.ndarray) -> np.ndarray:
    """Places (n,) of points (n, 3) on a Morton curve: the bits of their coordinates interleaved."""
    if not len(points):
        return np.empty(0, np.int64)
    size = max(float(np.ptp(points, axis=0).max()), 1e-300)
    cells = ((points - points.min(axis=0)) / size * (2**_BITS - 1)).astype(np.int64)
    places = np.zeros(len(points), np.int64)
    for bit in range(_BITS):
        for axis in range(3):
            places |= ((cells[:, axis] >> bit) & 1) << (3 * bit + axis)
    return places
