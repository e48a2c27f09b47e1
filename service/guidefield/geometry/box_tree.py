"""A tree of boxes, so that a kernel finds what is near a point without looking at everything."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from guidefield.geometry.curve_order import along_curve
from guidefield.kernels.distance.bvh import boxes_of_pairs
from guidefield.kernels.distance.triangle_distance import LEAF

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class BoxTree:
    """A complete binary tree as an array: node i has the children 2 i + 1 and 2 i + 2; a leaf holds `LEAF` boxes.

    Attributes:
        nodes: Lower and upper corners, shape (2 leaves - 1, 6) [m]; from plus to minus infinity where empty.
        leaves: Number of leaves, a power of two.
        order: The order in which the leaves hold the boxes, shape (n,).
    """

    nodes: Floats
    leaves: int
    order: Integers


def box_tree(low: Floats, high: Floats) -> BoxTree:
    """Build a tree over boxes, neighbours in space together (sorted along a Morton curve through their centres).

    Args:
        low: Lower corners, shape (n, 3) [m], n >= 1, finite.
        high: Upper corners, shape (n, 3) [m].
    """
    return tree_over(np.hstack([low, high]))


def tree_over(boxes: Floats) -> BoxTree:
    """The same over boxes as lower, then upper corners, shape (n, 6) [m]."""
    order = along_curve(0.5 * (boxes[:, :3] + boxes[:, 3:])).order
    nodes = box_nodes(np.take(boxes, order, axis=0))
    return BoxTree(nodes, (len(nodes) + 1) // 2, order)


def node_count(boxes: int) -> int:
    """How many nodes a tree over so many boxes has, at least one."""
    leaves = 1
    while leaves * LEAF < boxes:
        leaves *= 2
    return 2 * leaves - 1


def box_nodes(boxes: Floats) -> Floats:
    """The nodes of a tree over boxes, shape (n, 6), n >= 1, in the order in which its leaves hold them."""
    nodes = np.empty((node_count(len(boxes)), 6))
    boxes_of_pairs(np.ascontiguousarray(boxes), LEAF, nodes)
    return nodes
