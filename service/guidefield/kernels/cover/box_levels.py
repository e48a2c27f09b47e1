"""Boxes about boxes, level by level, and the cube about the middles of boxes."""

from __future__ import annotations

import math

from numba import int64, void

from guidefield.kernels.jit.signatures import (
    INDICES,
    MATRIX,
    MATRIX_OUT,
    VECTOR_OUT,
    Floats,
    Integers,
    exact_kernel,
    lane_part,
)


@lane_part
def _empty(box: Floats) -> None:
    """Make a box, shape (6,), one of nothing."""
    for k in range(3):
        box[k], box[3 + k] = math.inf, -math.inf


@lane_part
def _add(box: Floats, other: Floats) -> None:
    """Make a box, shape (6,), one about another one too."""
    for k in range(3):
        box[k], box[3 + k] = min(box[k], other[k]), max(box[3 + k], other[3 + k])


@exact_kernel(void(MATRIX_OUT, INDICES, int64))
def boxes_above(boxes: Floats, firsts: Integers, children: int) -> None:
    """Find the boxes of the levels of a tree above the first one.

    Args:
        boxes: Lower, then upper corners, shape (m, 6), those of the first level at the beginning; gets the others.
        firsts: Where each level begins among them, and the number of all, shape (levels + 1,).
        children: How many of a level are behind each of the next: those of box i begin at `children * i`.
    """
    for level in range(1, firsts.shape[0] - 1):
        for i in range(firsts[level + 1] - firsts[level]):
            box = boxes[firsts[level] + i]
            _empty(box)
            begin = firsts[level - 1] + children * i
            for child in range(begin, min(begin + children, firsts[level])):
                _add(box, boxes[child])


@exact_kernel(void(MATRIX, int64, MATRIX_OUT))
def boxes_of_pairs(boxes: Floats, leaf: int, nodes: Floats) -> None:
    """Find the boxes of a complete binary tree, in which node i has the children 2 i + 1 and 2 i + 2.

    Args:
        boxes: Lower, then upper corners, shape (n, 6).
        leaf: How many of them a leaf holds.
        nodes: Gets the boxes, the root's first; shape (2 leaves - 1, 6). Those of empty leaves are of nothing.
    """
    inner = nodes.shape[0] // 2
    for i in range(nodes.shape[0] - 1, -1, -1):
        box = nodes[i]
        _empty(box)
        if i < inner:
            _add(box, nodes[2 * i + 1])
            _add(box, nodes[2 * i + 2])
        else:
            for k in range(leaf * (i - inner), min(leaf * (i - inner + 1), boxes.shape[0])):
                _add(box, boxes[k])


@exact_kernel(void(MATRIX, VECTOR_OUT))
def middles_within(boxes: Floats, corners: Floats) -> None:
    """Find the box about the middles of boxes.

    Args:
        boxes: Lower, then upper corners, shape (n, 6).
        corners: Gets its lower, then its upper corner, shape (6,).
    """
    _empty(corners)
    for i in range(boxes.shape[0]):
        for k in range(3):
            middle = 0.5 * (boxes[i, k] + boxes[i, 3 + k])
            corners[k], corners[3 + k] = min(corners[k], middle), max(corners[3 + k], middle)
