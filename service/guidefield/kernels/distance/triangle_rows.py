"""Triangles row by row: boxes, corners as the distance kernels read them, triangles with an area, touching edges."""

from __future__ import annotations

import math

import numpy as np
from numba import types, void

from guidefield.kernels.jit.signatures import (
    BLOCKS,
    INDEX_MATRIX,
    INDEX_MATRIX_OUT,
    INDICES,
    INDICES_OUT as PAIR_OUT,
    MATRIX,
    MATRIX_OUT,
    SCALAR,
    VECTOR,
    Floats,
    Integers,
    compiled,
    exact_kernel,
    inlined,
)


@exact_kernel(void(MATRIX, INDEX_MATRIX, MATRIX_OUT))
def triangle_boxes(vertices: Floats, triangles: Integers, boxes_out: Floats) -> None:
    """Write the boxes about triangles.

    Args:
        vertices: Shape (v, 3) [m].
        triangles: Shape (t, 3).
        boxes_out: Gets lower, then upper corners, shape (t, 6) [m].
    """
    for t in range(triangles.shape[0]):
        for k in range(3):
            a, b, c = vertices[triangles[t, 0], k], vertices[triangles[t, 1], k], vertices[triangles[t, 2], k]
            boxes_out[t, k], boxes_out[t, 3 + k] = min(a, b, c), max(a, b, c)


@exact_kernel(void(MATRIX, INDEX_MATRIX, INDICES, MATRIX_OUT))
def corners_and_edges(vertices: Floats, triangles: Integers, order: Integers, rows_out: Floats) -> None:
    """Write corner a and edges b - a and c - a of triangles.

    Args:
        vertices: Shape (v, 3) [m].
        triangles: Shape (t, 3).
        order: Of which they are written, in which order, shape (n,).
        rows_out: Shape (n, 9) [m].
    """
    for row in range(order.shape[0]):
        t = order[row]
        for k in range(3):
            a = vertices[triangles[t, 0], k]
            rows_out[row, k] = a
            rows_out[row, 3 + k] = vertices[triangles[t, 1], k] - a
            rows_out[row, 6 + k] = vertices[triangles[t, 2], k] - a


@exact_kernel(void(MATRIX, INDEX_MATRIX, MATRIX_OUT))
def corner_sums(vertices: Floats, triangles: Integers, sums_out: Floats) -> None:
    """Write the sums of the corners of triangles.

    Args:
        vertices: Shape (v, 3) [m].
        triangles: Shape (t, 3).
        sums_out: Shape (t, 3) [m].
    """
    for t in range(triangles.shape[0]):
        for k in range(3):
            sums_out[t, k] = vertices[triangles[t, 0], k] + vertices[triangles[t, 1], k] + vertices[triangles[t, 2], k]


@exact_kernel(void(MATRIX, INDEX_MATRIX, INDICES, types.int64, types.Array(types.int32, 2, "C"), MATRIX_OUT))
def runs_of_triangles(
    vertices: Floats, triangles: Integers, order: Integers, size: int, triangles_out: np.ndarray, boxes_out: Floats
) -> None:
    """Write triangles in an order, and the boxes about runs of them.

    Args:
        vertices: Shape (v, 3) [m].
        triangles: Shape (t, 3).
        order: Shape (t,).
        size: How many there are in each run but the last.
        triangles_out: Shape (t, 3).
        boxes_out: Gets lower, then upper corners, shape (runs, 6) [m].
    """
    for run in range(boxes_out.shape[0]):
        boxes_out[run, :3], boxes_out[run, 3:] = math.inf, -math.inf
        for row in range(run * size, min(order.shape[0], (run + 1) * size)):
            for corner in range(3):
                vertex = triangles[order[row], corner]
                triangles_out[row, corner] = vertex
                for k in range(3):
                    boxes_out[run, k] = min(boxes_out[run, k], vertices[vertex, k])
                    boxes_out[run, 3 + k] = max(boxes_out[run, 3 + k], vertices[vertex, k])


_FOUND = types.Array(types.boolean, 1, "C")


@inlined
def _squared(vertices: Floats, a: int, b: int) -> float:
    """Square of the length of an edge [m^2]."""
    square = 0.0
    for k in range(3):
        square += (vertices[b, k] - vertices[a, k]) ** 2
    return square


@compiled(void(MATRIX, INDEX_MATRIX, SCALAR, _FOUND))
def wide_triangles(vertices: Floats, triangles: Integers, thin: float, wide_out: np.ndarray) -> None:
    """Find which triangles have an area.

    Args:
        vertices: Shape (v, 3) [m].
        triangles: Shape (t, 3).
        thin: Twice the area of one that has next to none, as a share of its longest edge squared.
        wide_out: Gets whether each has more, shape (t,).
    """
    for t in range(triangles.shape[0]):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        square = 0.0
        for k in range(3):
            i, j = (k + 1) % 3, (k + 2) % 3
            across = (vertices[b, i] - vertices[a, i]) * (vertices[c, j] - vertices[a, j])
            across -= (vertices[b, j] - vertices[a, j]) * (vertices[c, i] - vertices[a, i])
            square += across * across
        longest = max(_squared(vertices, a, b), _squared(vertices, b, c), _squared(vertices, c, a))
        wide_out[t] = square > (thin * longest) ** 2


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
    """Tell if edges i and j cross or come that near."""
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
