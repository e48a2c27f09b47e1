"""Read declared points and triangles, in triples or packed."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

from guidefield.messages import scene as messages
from guidefield.messages.triples import Points, Triangles
from guidefield.messages.values import Float32Array, Uint32Array


def points_in(points: Points) -> np.ndarray:
    """Return the points of a message, shape (n, 3) [m]."""
    if isinstance(points, Float32Array):
        return np.frombuffer(points.float32, "<f4").reshape(-1, 3).astype(float)
    return _triples(points, float)


def corners_in(triangles: Triangles) -> np.ndarray:
    """Return the indices of triangles' corners in a message, shape (t, 3)."""
    if isinstance(triangles, Uint32Array):
        return np.frombuffer(triangles.uint32, "<u4").reshape(-1, 3).astype(np.int64)
    return _triples(triangles, np.int64)


def _triples(listed: list[Any], kind: type) -> np.ndarray:
    flat = itertools.chain.from_iterable(listed)  # which NumPy reads in a third of the time
    return np.fromiter(flat, kind, 3 * len(listed)).reshape(-1, 3)


def count_of(some: Points | Triangles) -> int:
    """Return the number of points or triangles in a message."""
    match some:
        case Float32Array():
            return len(some.float32) // 12
        case Uint32Array():
            return len(some.uint32) // 12
    return len(some)


def are_many(declared: Sequence[messages.Obstacle | messages.GuidePlane], most: int) -> bool:
    """Return whether obstacles or guide planes with their corners, triangles, points and places are at least `most`."""
    return len(declared) >= most or len(declared) + sum(map(_parts, declared)) >= most


def _parts(declared: messages.Obstacle | messages.GuidePlane) -> int:
    """Count the corners, triangles, points and places of a declaration; 0 for a primitive at rest."""
    match declared:
        case messages.GuidePlane():
            return len(declared.vertices)
        case messages.Polygon():
            parts = len(declared.vertices)
        case messages.Mesh():
            parts = count_of(declared.triangles) + count_of(declared.vertices)
        case messages.PointCloud():
            parts = count_of(declared.points)
        case _:
            parts = 0
    return parts if declared.trajectory is None else parts + len(declared.trajectory.times)
