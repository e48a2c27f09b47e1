"""Triangles as a body: whether they are closed, and how often they wind around a point."""

from __future__ import annotations

import numpy as np


def closed(triangles: np.ndarray) -> bool:
    """Whether every edge of triangles (t, 3, 3) is run through as often in one direction as in the other."""
    index = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)[1].reshape(-1, 3)
    edges = np.column_stack([index.ravel(), np.roll(index, -1, axis=1).ravel()])
    return len(edges) > 0 and sorted(edges.tolist()) == sorted(edges[:, ::-1].tolist())


def winding(point: np.ndarray, triangles: np.ndarray) -> float:
    """How often closed triangles (t, 3, 3) wind around a point (3,): their solid angles over 4 pi."""
    arms = triangles - point
    (a, b, c), (ab, bc, ca) = np.linalg.norm(arms, axis=2).T, (arms * np.roll(arms, -1, axis=1)).sum(axis=2).T
    return float(np.arctan2(np.linalg.det(arms), a * b * c + ab * c + bc * a + ca * b).sum() / (2 * np.pi))
