"""Few balls inside a convex shape: where one of them meets an obstacle, the shape certainly does."""

from __future__ import annotations

import functools
from typing import Any

import coal
import numpy as np

from guidefield.robot.shapes import triangulation

COUNT = 8
"""Most balls of a shape."""

_GRID = 12
"""Places along each side of the box about a shape where balls may stand."""

_SPACING = 0.8
"""How far apart balls stand, in radii of the larger."""


def inner_balls(shape: Any) -> np.ndarray:
    """Balls inside a Coal shape, shape (k, 4): centres in its frame and radii [m]; none in what isn't convex."""
    if isinstance(shape, coal.Convex):
        vertices, triangles = triangulation(shape)
        return _within(vertices[triangles].tobytes())
    if isinstance(shape, coal.Sphere):
        return np.array([[0.0, 0.0, 0.0, shape.radius]])
    if isinstance(shape, coal.Box):
        return _along_axis(np.array(shape.halfSide))
    if isinstance(shape, coal.Cylinder):
        return _along_axis(np.array([shape.radius, shape.radius, shape.halfLength]))
    if isinstance(shape, coal.Capsule):
        return _along_axis(np.array([shape.radius, shape.radius, shape.halfLength + shape.radius]))
    return np.empty((0, 4))


def _along_axis(halves: np.ndarray) -> np.ndarray:
    """Balls along the longest axis of a box, or of a body of revolution that touches its faces."""
    radius, longest = float(halves.min()), int(np.argmax(halves))
    count = int(np.clip(np.ceil(halves[longest] / radius), 1, COUNT))
    balls = np.zeros((count, 4))
    balls[:, longest] = np.linspace(-1.0, 1.0, count) * (halves[longest] - radius) if count > 1 else 0.0
    balls[:, 3] = radius
    return balls


@functools.lru_cache(maxsize=256)
def _within(corners: bytes) -> np.ndarray:
    """Balls inside a convex polytope, given as the bytes of its triangles (t, 3, 3): the deepest first, apart."""
    triangles = np.frombuffer(corners).reshape(-1, 3, 3)
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    proper = lengths > 1e-12
    normals = normals[proper] / lengths[proper, None]
    offsets = np.einsum("ij,ij->i", normals, triangles[proper, 0])
    centre = triangles.reshape(-1, 3).mean(axis=0)
    outwards = np.where(offsets >= normals @ centre, 1.0, -1.0)
    normals, offsets = normals * outwards[:, None], offsets * outwards
    low, high = triangles.reshape(-1, 3).min(axis=0), triangles.reshape(-1, 3).max(axis=0)
    sides = [np.linspace(a, b, _GRID + 2)[1:-1] for a, b in zip(low, high, strict=True)]
    places = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3)
    depths = (offsets - places @ normals.T).min(axis=1)
    balls: list[np.ndarray] = []
    while len(balls) < COUNT and depths.max() > 0.0:
        deepest = int(np.argmax(depths))
        ball = np.array([*places[deepest], depths[deepest]])
        balls.append(ball)
        far = np.linalg.norm(places - ball[:3], axis=1) > _SPACING * ball[3]
        depths = np.where(far, depths, 0.0)
    found = np.array(balls).reshape(-1, 4)
    found.setflags(write=False)
    return found
