"""Edges of a closed outline that touch though they aren't neighbours."""

from __future__ import annotations

import numpy as np
from numba import void

from guidefield.kernels.jit.signatures import (
    BLOCKS,
    INDEX_MATRIX,
    INDEX_MATRIX_OUT,
    INDICES,
    INDICES_OUT as PAIR_OUT,
    MATRIX,
    SCALAR,
    VECTOR,
    Floats,
    Integers,
    compiled,
    inlined,
)


@inlined
def _from_segment(x: float, y: float, ax: float, ay: float, bx: float, by: float) -> float:
    """Distance of a point to the segment a b."""
    along_x, along_y = bx - ax, by - ay
    share = ((x - ax) * along_x + (y - ay) * along_y) / (along_x * along_x + along_y * along_y)
    share = min(max(share, 0.0), 1.0)
    return float(np.hypot(x - (ax + share * along_x), y - (ay + share * along_y)))


@inlined
def _turn(ax: float, ay: float, bx: float, by: float, cx: float, cy: float) -> float:
    """Twice the signed area of the triangle a b c."""
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


@inlined
def _touch(corners: Floats, i: int, j: int, gap: float) -> bool:
    """Whether edges i and j cross or come that near."""
    count = corners.shape[0]
    ax, ay = corners[i]
    bx, by = corners[(i + 1) % count]
    cx, cy = corners[j]
    dx, dy = corners[(j + 1) % count]
    near = min(_from_segment(cx, cy, ax, ay, bx, by), _from_segment(dx, dy, ax, ay, bx, by))
    near = min(near, _from_segment(ax, ay, cx, cy, dx, dy), _from_segment(bx, by, cx, cy, dx, dy))
    if near <= gap:
        return True
    across = _turn(ax, ay, bx, by, cx, cy) * _turn(ax, ay, bx, by, dx, dy) < 0.0
    return bool(across and _turn(cx, cy, dx, dy, ax, ay) * _turn(cx, cy, dx, dy, bx, by) < 0.0)


@compiled(PAIR_OUT(MATRIX, MATRIX, INDICES, SCALAR))
def touching_edges(corners: Floats, boxes: Floats, order: Integers, gap: float) -> Integers:
    """The first two edges that aren't neighbours and cross or come near; edge i runs from corner i to i + 1.

    A sweep along x: an edge meets only those that begin before it ends.

    Args:
        corners: Shape (k, 2) [m].
        boxes: Of each edge its least x and y, and its largest, shape (k, 4) [m].
        order: The edges by their least x, shape (k,).
        gap: How near counts as touching [m].

    Returns:
        Their numbers, of all pairs those with the least first one, and of these with the least other; two times k where
        none touch.
    """
    count = corners.shape[0]
    found = np.full(2, count)
    for at in range(count):
        one = order[at]
        for later in range(at + 1, count):
            other = order[later]
            if boxes[other, 0] > boxes[one, 2] + 2.0 * gap:
                break
            if boxes[other, 1] > boxes[one, 3] + 2.0 * gap or boxes[one, 1] > boxes[other, 3] + 2.0 * gap:
                continue
            i, j = min(one, other), max(one, other)
            if j - i < 2 or (i == 0 and j == count - 1) or (i, j) > (found[0], found[1]):
                continue
            if _touch(corners, i, j, gap):
                found[0], found[1] = i, j
    return found


@compiled(void(BLOCKS, BLOCKS, INDEX_MATRIX, VECTOR, INDEX_MATRIX_OUT))
def touching_edges_of_each(corners: Floats, boxes: Floats, order: Integers, gaps: Floats, found_out: Integers) -> None:
    """Find the first touching edges of each of n outlines, row by row as `touching_edges` does.

    Args:
        corners: Shape (n, k, 2) [m].
        boxes: Shape (n, k, 4) [m].
        order: Shape (n, k).
        gaps: Shape (n,) [m].
        found_out: Shape (n, 2).
    """
    for i in range(corners.shape[0]):
        found_out[i] = touching_edges(corners[i], boxes[i], order[i], gaps[i])
