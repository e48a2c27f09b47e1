"""Pseudonormals of a triangle mesh: which side of the surface a point is on, also next to an edge or a corner."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from guidefield.kernels.distance.pseudonormal_sums import summed_normals

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


def pseudonormals(vertices: Floats, triangles: Integers) -> Floats:
    """Unit pseudonormals of the parts of every triangle, as kernels/distance/triangle_distance.py reads them.

    That of an edge is the sum of the normals of its faces; that of a corner the sum of those of its faces, each
    weighted by its angle there. Where they cancel it is zero.

    Args:
        vertices: Shape (v, 3) [m].
        triangles: Shape (t, 3), counter-clockwise from outside, each with an area.

    Returns:
        Shape (t, 21): face; edges ab, bc, ca; corners a, b, c.
    """
    start, end = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    edges = _numbered(np.minimum(start, end) * (int(triangles.max()) + 1) + np.maximum(start, end))
    normals = np.empty((len(triangles), 21))
    vertices, triangles = np.ascontiguousarray(vertices, float), np.ascontiguousarray(triangles, np.int64)
    summed_normals(vertices, triangles, edges, int(edges.max()) + 1, normals)
    return normals


def _numbered(keys: Integers) -> Integers:
    """Keys (n,) as numbers from 0, in their order."""
    order = np.argsort(keys, kind="stable")
    number = np.empty(len(keys), np.int64)
    number[order] = np.cumsum(np.diff(keys[order], prepend=-1) != 0) - 1
    return number
