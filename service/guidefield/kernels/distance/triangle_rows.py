"""Triangles row by row: the boxes about them and about runs, and their corners as the distance kernels read them."""

from __future__ import annotations

import math

import numpy as np
from numba import types, void

from guidefield.kernels.jit.signatures import (
    INDEX_MATRIX,
    INDICES,
    MATRIX,
    MATRIX_OUT,
    Floats,
    Integers,
    exact_kernel,
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
