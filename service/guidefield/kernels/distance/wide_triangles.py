"""Which triangles of a surface have an area."""

from __future__ import annotations

import numpy as np
from numba import types, void

from guidefield.kernels.jit.signatures import INDEX_MATRIX, MATRIX, SCALAR, Floats, Integers, compiled, inlined

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
