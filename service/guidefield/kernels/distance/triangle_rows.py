"""Triangles row by row: the boxes about them, and their corners as the distance kernels read them."""

from __future__ import annotations

from numba import void

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
