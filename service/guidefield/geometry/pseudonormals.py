"""Pseudonormals of a triangle mesh: which side of the surface a point is on, also next to an edge or a corner."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from guidefield.geometry.edges import numbered_edges
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
    normals = np.empty((len(triangles), 21))
    write_pseudonormals(vertices, triangles, np.arange(len(triangles)), normals)
    return normals


def write_pseudonormals(vertices: Floats, triangles: Integers, order: Integers, normals_out: Floats) -> None:
    """Write them of some of the triangles, indices of shape (n,), in that order; shape (n, 21)."""
    edges, count = numbered_edges(triangles)
    vertices, triangles = np.ascontiguousarray(vertices, float), np.ascontiguousarray(triangles, np.int64)
    summed_normals(vertices, triangles, edges, count, order, normals_out)
