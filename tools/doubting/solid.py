"""Whether a mesh is closed, and whether a point is inside it: by its edges, and by the winding number."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

CRACK = 1e-3
"""Corners that are no farther apart are at one place [m]."""


def is_closed(vertices: np.ndarray, triangles: np.ndarray, crack: float = CRACK) -> bool:
    """Whether each edge is run through as often in one sense as in the other, corners at one place being one."""
    places, corners = np.unique(vertices, axis=0, return_inverse=True)
    near = cKDTree(places).query_pairs(crack, output_type="ndarray")
    links = coo_array((np.ones(len(near), bool), (near[:, 0], near[:, 1])), shape=(len(places), len(places)))
    merged = connected_components(links, directed=False)[1][corners.reshape(-1)][triangles]
    starts, ends = merged.reshape(-1).astype(np.int64), np.roll(merged, -1, axis=1).reshape(-1).astype(np.int64)
    differ = starts != ends
    forth, back = np.sort((starts * len(places) + ends)[differ]), np.sort((ends * len(places) + starts)[differ])
    return bool(np.array_equal(forth, back))


def encloses(vertices: np.ndarray, triangles: np.ndarray, point: np.ndarray) -> bool:
    """Whether a closed mesh winds around a point: its solid angles there (van Oosterom and Strackee 1983) add up."""
    a, b, c = (vertices[triangles[:, k]] - point for k in range(3))
    la, lb, lc = (np.linalg.norm(one, axis=1) for one in (a, b, c))
    numerator = (a * np.cross(b, c)).sum(axis=1)
    denominator = la * lb * lc + (a * b).sum(axis=1) * lc + (b * c).sum(axis=1) * la + (c * a).sum(axis=1) * lb
    return bool(abs(np.arctan2(numerator, denominator).sum() / (2.0 * np.pi)) > 0.5)
