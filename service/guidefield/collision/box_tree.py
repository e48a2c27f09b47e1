"""A tree of boxes along the world's axes: those that overlap others are found without looking at all of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from guidefield.geometry.curve_order import Along, along_curve, changed_along
from guidefield.kernels.distance.bvh import boxes_above, overlaps_in_tree
from guidefield.read_only import ReadOnly
from guidefield.scene.incremental import Rows

CHILDREN = 16
"""Boxes behind one box of the next level."""

FEW = 16
"""For so many overlaps of each box there is room before it is known how many there are."""

_BITS = 16
"""Bits of one coordinate of a place on the curve along which boxes are sorted."""


@dataclass(frozen=True, eq=False)
class BoxTree(ReadOnly):
    """Boxes in the order of their centres along a Morton curve, and above them boxes about every `CHILDREN` of them.

    `nodes` are lower, then upper corners (m, 6) [m], level by level from the boxes themselves up to one of `CHILDREN`
    at most; `firsts` tells where each level begins, then the number of all.
    """

    along: Along
    nodes: np.ndarray
    firsts: np.ndarray

    @classmethod
    def of(cls, boxes: np.ndarray) -> BoxTree:
        """Sort boxes, lower, then upper corners, shape (n, 6), finite [m]."""
        along = along_curve(0.5 * (boxes[:, :3] + boxes[:, 3:]), _BITS)
        nodes, firsts = _room(len(boxes))
        if len(boxes):
            np.take(boxes, along.order, axis=0, out=nodes[: len(boxes)], mode="clip")
        boxes_above(nodes, firsts, CHILDREN)
        return cls(along, nodes, firsts)

    def changed(self, rows: Rows, fresh: np.ndarray) -> BoxTree | None:
        """The tree of boxes of which some are others (k, 6) [m]: the very one, or None if it is sooner made anew."""
        if not rows.count or not rows.before:
            return None
        along, runs, turn = changed_along(
            self.along, rows.now, rows.fresh, 0.5 * (fresh[:, :3] + fresh[:, 3:]), rows.count
        )
        nodes, firsts = _room(rows.count)
        boxes = nodes[: rows.count]
        Rows(runs, rows.before).carry(self.boxes, fresh[turn], boxes)
        if not along.is_of(boxes):
            return None
        boxes_above(nodes, firsts, CHILDREN)
        return BoxTree(along, nodes, firsts)

    @property
    def order(self) -> np.ndarray:
        """Index of each box as it was given, in the order in which the tree has them, shape (n,)."""
        return self.along.order

    @property
    def boxes(self) -> np.ndarray:
        """The boxes themselves, shape (n, 6)."""
        return self.nodes[: len(self.along.order)]

    def overlapping(self, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Which of the boxes overlap which of others, corners (q, 3) [m]; boxes that touch do.

        Index of one of the others and of a box as it was given, both of shape (k,), in this order.
        """
        low, high = np.ascontiguousarray(low, float), np.ascontiguousarray(high, float)
        pairs = np.empty((FEW * len(low), 2), np.int64)
        count = overlaps_in_tree(self.nodes, self.firsts, CHILDREN, low, high, pairs)
        if count > len(pairs):
            pairs = np.empty((count, 2), np.int64)
            overlaps_in_tree(self.nodes, self.firsts, CHILDREN, low, high, pairs)
        asked, found = pairs[:count, 0], self.order[pairs[:count, 1]]
        sorted_ = np.lexsort((found, asked))
        return asked[sorted_], found[sorted_]


def _room(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Room for the nodes of a tree of so many boxes, shape (m, 6), and where its levels begin."""
    sizes = [count]
    while sizes[-1] > CHILDREN:
        sizes.append(-(-sizes[-1] // CHILDREN))
    firsts = np.cumsum([0, *sizes])
    return np.empty((int(firsts[-1]), 6)), firsts
