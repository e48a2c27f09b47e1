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
    SCALAR,
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
def _side(vertices: Floats, triangles: Integers, t: int, corner: int, k: int) -> float:
    """Along an axis, the side of a triangle that leaves a corner."""
    return float(vertices[triangles[t, (corner + 1) % 3], k] - vertices[triangles[t, corner], k])


@inlined
def _angle(sides: Floats, corner: int) -> float:
    """The angle at a triangle's corner, of unit sides, shape (3, 3): the one that leaves it and the one that comes."""
    leaving, coming = corner, (corner + 2) % 3
    x = sides[leaving, 1] * sides[coming, 2] - sides[leaving, 2] * sides[coming, 1]
    y = sides[leaving, 2] * sides[coming, 0] - sides[leaving, 0] * sides[coming, 2]
    z = sides[leaving, 0] * sides[coming, 1] - sides[leaving, 1] * sides[coming, 0]
    along = 0.0
    for k in range(3):
        along += sides[leaving, k] * sides[coming, k]
    return math.atan2(math.sqrt(x * x + y * y + z * z), -along)


@compiled(SCALAR(MATRIX, INDEX_MATRIX, MATRIX_OUT))
def _faces(vertices: Floats, triangles: Integers, faces_out: Floats) -> float:
    """Write a normal of each triangle, not of unit length, shape (t, 3); the longest side [m]."""
    longest = 0.0
    for t in range(triangles.shape[0]):
        for corner in range(3):
            square = 0.0
            for k in range(3):
                square += _side(vertices, triangles, t, corner, k) ** 2
            longest = max(longest, square)
        for k in range(3):
            i, j = (k + 1) % 3, (k + 2) % 3
            to = _side(vertices, triangles, t, 0, j) * _side(vertices, triangles, t, 2, i)
            faces_out[t, k] = to - _side(vertices, triangles, t, 0, i) * _side(vertices, triangles, t, 2, j)
    return math.sqrt(longest)


@compiled(void(MATRIX, INDEX_MATRIX, INDICES, types.int64, INDICES, MATRIX_OUT))
def summed_normals(
    vertices: Floats, triangles: Integers, edges: Integers, n_edges: int, order: Integers, normals_out: Floats
) -> None:
    """Unit pseudonormals of triangles: of the face, of edges ab, bc, ca, of corners a, b, c.

    Args:
        vertices: Shape (v, 3) [m].
        triangles: Shape (t, 3).
        edges: Which edge the three of each triangle are, shape (3 t,).
        n_edges: How many edges there are.
        order: Of which triangles they are written, in which order, shape (n,).
        normals_out: Shape (n, 21).
    """
    faces, sides = np.empty((triangles.shape[0], 3)), np.empty((3, 3))
    least = NOTHING * max(_faces(vertices, triangles, faces), SHORTEST)
    _to_unit(faces)
    of_edges, of_corners = np.zeros((n_edges, 3)), np.zeros((vertices.shape[0], 3))
    for t in range(triangles.shape[0]):
        for corner in range(3):
            square = 0.0
            for k in range(3):
                sides[corner, k] = _side(vertices, triangles, t, corner, k)
                square += sides[corner, k] ** 2
            length = math.sqrt(square)
            for k in range(3):
                sides[corner, k] = sides[corner, k] / length if length > least else 0.0
        for part in range(3):
            edge, corner, angle = edges[3 * t + part], triangles[t, part], _angle(sides, part)
            for k in range(3):
                of_edges[edge, k] += faces[t, k]
                of_corners[corner, k] += angle * faces[t, k]
    _to_unit(of_edges)
    _to_unit(of_corners)
    for row in range(order.shape[0]):
        t = order[row]
        for k in range(3):
            normals_out[row, k] = faces[t, k]
            for part in range(3):
                normals_out[row, 3 + 3 * part + k] = of_edges[edges[3 * t + part], k]
                normals_out[row, 12 + 3 * part + k] = of_corners[triangles[t, part], k]
