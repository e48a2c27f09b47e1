"""Pseudonormals of the parts of triangles: sums of faces' normals over edges, and over corners by the angles there."""

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
    compiled,
    inlined,
)

NOTHING = 1e-14
"""Vectors shorter than this share of the longest are rounding."""

SHORTEST = 1e-300
"""Longest vectors shorter than this are none."""


@compiled(void(MATRIX_OUT))
def _to_unit(vectors: Floats) -> None:
    """Scale vectors, shape (n, 3), to length 1; those that are rounding to zero."""
    most = 0.0
    for i in range(vectors.shape[0]):
        most = max(most, vectors[i, 0] ** 2 + vectors[i, 1] ** 2 + vectors[i, 2] ** 2)
    least = NOTHING * max(math.sqrt(most), SHORTEST)
    for i in range(vectors.shape[0]):
        length = math.sqrt(vectors[i, 0] ** 2 + vectors[i, 1] ** 2 + vectors[i, 2] ** 2)
        for k in range(3):
            vectors[i, k] = vectors[i, k] / length if length > least else 0.0


@inlined
def _dot(a: Floats, i: int, b: Floats, j: int) -> float:
    return float(a[i, 0] * b[j, 0] + a[i, 1] * b[j, 1] + a[i, 2] * b[j, 2])


@inlined
def _angle(sides: Floats, t: int, corner: int) -> float:
    """The angle at a triangle's corner, of unit sides: the one that leaves it and the one that comes to it."""
    leaving, coming = 3 * t + corner, 3 * t + (corner + 2) % 3
    x = sides[leaving, 1] * sides[coming, 2] - sides[leaving, 2] * sides[coming, 1]
    y = sides[leaving, 2] * sides[coming, 0] - sides[leaving, 0] * sides[coming, 2]
    z = sides[leaving, 0] * sides[coming, 1] - sides[leaving, 1] * sides[coming, 0]
    return math.atan2(math.sqrt(x * x + y * y + z * z), -_dot(sides, leaving, sides, coming))


@compiled(void(MATRIX, INDEX_MATRIX, INDICES, types.int64, MATRIX_OUT))
def summed_normals(vertices: Floats, triangles: Integers, edges: Integers, n_edges: int, normals_out: Floats) -> None:
    """Unit pseudonormals of triangles: of the face, of edges ab, bc, ca, of corners a, b, c.

    Args:
        vertices: Shape (v, 3) [m].
        triangles: Shape (t, 3).
        edges: Which edge the three of each triangle are, shape (3 t,).
        n_edges: How many edges there are.
        normals_out: Shape (t, 21).
    """
    count = triangles.shape[0]
    sides, faces = np.empty((3 * count, 3)), np.empty((count, 3))
    for t in range(count):
        for corner in range(3):
            start, end = triangles[t, corner], triangles[t, (corner + 1) % 3]
            for k in range(3):
                sides[3 * t + corner, k] = vertices[end, k] - vertices[start, k]
        first, last = 3 * t, 3 * t + 2
        for k in range(3):
            i, j = (k + 1) % 3, (k + 2) % 3
            faces[t, k] = sides[first, j] * sides[last, i] - sides[first, i] * sides[last, j]
    _to_unit(faces)
    _to_unit(sides)
    of_edges, of_corners = np.zeros((n_edges, 3)), np.zeros((vertices.shape[0], 3))
    for t in range(count):
        for part in range(3):
            edge, corner, angle = edges[3 * t + part], triangles[t, part], _angle(sides, t, part)
            for k in range(3):
                of_edges[edge, k] += faces[t, k]
                of_corners[corner, k] += angle * faces[t, k]
    _to_unit(of_edges)
    _to_unit(of_corners)
    for t in range(count):
        for k in range(3):
            normals_out[t, k] = faces[t, k]
            for part in range(3):
                normals_out[t, 3 + 3 * part + k] = of_edges[edges[3 * t + part], k]
                normals_out[t, 12 + 3 * part + k] = of_corners[triangles[t, part], k]
