"""A tree of boxes, so that a kernel finds what is near a point without looking at everything."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from guidefield.kernels.distance.triangle_distance import LEAF

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_BITS = 21
"""Bits of one coordinate of a Morton code: three fit into 63."""


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
    order = _in_order(on_curve(0.5 * (low + high)))
    leaves = 1
    while leaves * LEAF < len(order):
        leaves *= 2
    boxes = np.tile(np.array([np.inf, -np.inf]).repeat(3), (leaves * LEAF, 1))
    boxes[: len(order)] = np.take(np.hstack([low, high]), order, axis=0)
    level = _united(boxes.reshape(leaves, LEAF, 6))
    levels = [level]
    while len(level) > 1:
        level = _united(level.reshape(-1, 2, 6))
        levels.append(level)
    return BoxTree(np.ascontiguousarray(np.concatenate(levels[::-1])), leaves, order)


def _in_order(codes: Integers) -> Integers:
    """The order of positions (n,), of the same ones that of their indices: sooner found where no two are the same."""
    order = np.argsort(codes)
    in_turn = codes[order]
    return np.argsort(codes, kind="stable") if (in_turn[1:] == in_turn[:-1]).any() else order


def _united(boxes: Floats) -> Floats:
    """Boxes (m, 6) about groups of boxes (m, k, 6)."""
    low, high = boxes[:, 0, :3], boxes[:, 0, 3:]
    for other in range(1, boxes.shape[1]):  # one after the other, which NumPy does in a fifth of what `min` takes
        low, high = np.minimum(low, boxes[:, other, :3]), np.maximum(high, boxes[:, other, 3:])
    return np.hstack([low, high])


def on_curve(points: Floats) -> Integers:
    """Positions (n,) of points (n, 3) on a Morton curve, along which neighbours are near each other.

    The bits of their coordinates in turn (G. M. Morton, 1966).
    """
    along = np.ascontiguousarray(points.T)  # NumPy takes a third of the time for coordinates one behind the other
    least = along.min(axis=1, keepdims=True)
    size = max(float((along.max(axis=1, keepdims=True) - least).max()), 1e-300)
    cells = ((along - least) / size * (2**_BITS - 1)).astype(np.int64)
    for shift, kept in _SPREAD:
        cells = (cells | cells << shift) & kept
    code: Integers = cells[0] | cells[1] << 1 | cells[2] << 2
    return code


_SPREAD = (
    (32, 0x001F00000000FFFF),
    (16, 0x001F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)
"""Shifts and masks that put two zeros between the bits of a number of `_BITS` bits."""
