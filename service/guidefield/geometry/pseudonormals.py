"""Pseudonormals of a triangle mesh: which side of the surface a point is on, also next to an edge or a corner."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

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
    corners = vertices[triangles]
    faces = _unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    edges = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2), axis=2).reshape(-1, 2)
    _, edge = np.unique(edges, axis=0, return_inverse=True)
    of_edges = _summed(edge.reshape(-1), np.repeat(faces, 3, axis=0))
    weighted = (_angles(corners)[:, :, None] * faces[:, None, :]).reshape(-1, 3)
    of_corners = _summed(triangles.reshape(-1), weighted)
    return np.ascontiguousarray(np.hstack([faces, of_edges.reshape(-1, 9), of_corners.reshape(-1, 9)]))


def _summed(owners: Integers, vectors: Floats) -> Floats:
    """For each vector (n, 3) the unit sum of all vectors with the same owner (n,)."""
    sums = np.zeros((int(owners.max()) + 1, 3))
    np.add.at(sums, owners, vectors)
    return _unit(sums)[owners]


def _angles(corners: Floats) -> Floats:
    """Angle at every corner, shape (t, 3) [rad], of triangles (t, 3, 3)."""
    forward = _unit(np.roll(corners, -1, axis=1) - corners)
    backward = _unit(np.roll(corners, 1, axis=1) - corners)
    sine = np.linalg.norm(np.cross(forward, backward), axis=2)
    angles: Floats = np.arctan2(sine, (forward * backward).sum(axis=2))
    return angles


def _unit(vectors: Floats) -> Floats:
    """Vectors (..., 3) scaled to length 1; those shorter than rounding to zero."""
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    unit: Floats = np.where(
        lengths > 1e-14 * max(float(lengths.max()), 1e-300), vectors / np.maximum(lengths, 1e-300), 0.0
    )
    return unit
