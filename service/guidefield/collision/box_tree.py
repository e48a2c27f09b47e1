"""A tree of boxes along the world's axes: those that overlap others are found without looking at all of them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from guidefield.geometry.curve_order import curve_order
from guidefield.kernels.cover.overlapping_boxes import overlaps_in_tree

CHILDREN = 16
"""Boxes behind one box of the next level."""

FEW = 16
"""For so many overlaps of each box there is room before it is known how many there are."""

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
        order = curve_order(0.5 * (low + high), _BITS)
        levels = [np.ascontiguousarray(np.take(np.hstack([low, high]), order, axis=0).T)]
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
        boxes, firsts = self._rows
        low, high = np.ascontiguousarray(low, float), np.ascontiguousarray(high, float)
        pairs = np.empty((FEW * len(low), 2), np.int64)
        count = overlaps_in_tree(boxes, firsts, CHILDREN, low, high, pairs)
        if count > len(pairs):
            pairs = np.empty((count, 2), np.int64)
            overlaps_in_tree(boxes, firsts, CHILDREN, low, high, pairs)
        asked, found = pairs[:count, 0], self.order[pairs[:count, 1]]
        sorted_ = np.lexsort((found, asked))
        return asked[sorted_], found[sorted_]

    @cached_property
    def _rows(self) -> tuple[np.ndarray, np.ndarray]:
        """The boxes of all levels as rows, shape (m, 6) [m], and where each level begins and the last one ends."""
        sizes = [level.shape[1] for level in self.levels]
        rows = np.ascontiguousarray(np.concatenate(self.levels, axis=1).T)
        return rows, np.cumsum([0, *sizes])
