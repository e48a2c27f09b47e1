"""Cores that hold bodies: the hull of some corners with a disc at each point, and what is within a radius of that."""

from __future__ import annotations

from typing import Any, NamedTuple

import coal
import numpy as np

MOST_CORNERS = 512
"""Of a hull of more its box is the core: to look at all of its corners takes as long as Coal does."""


class Core(NamedTuple):
    """What a body is in, in its own frame.

    Attributes:
        corners: Shape (k, 3) [m]; none where nothing so simple holds it.
        disc: Radius of a disc about the frame's last axis [m].
        rounded: Radius of a ball [m].
        filled: Whether the body fills it.
    """

    corners: np.ndarray
    disc: float = 0.0
    rounded: float = 0.0
    filled: bool = True


def core_of(shape: Any) -> Core:
    """The core of a Coal shape."""
    core = _core_of(shape)
    swept = shape.getSweptSphereRadius() if hasattr(shape, "getSweptSphereRadius") else 0.0
    return core._replace(rounded=core.rounded + swept)


def _core_of(shape: Any) -> Core:
    if isinstance(shape, coal.Convex):
        points = np.array(shape.points(), float)
        return Core(points) if len(points) <= MOST_CORNERS else Core(_box_of(points), filled=False)
    if isinstance(shape, coal.Box):
        return Core(_SIGNS * np.array(shape.halfSide, float))
    if isinstance(shape, coal.Sphere):
        return Core(np.zeros((1, 3)), rounded=shape.radius)
    if isinstance(shape, coal.Capsule):
        return Core(_ENDS * shape.halfLength, rounded=shape.radius)
    if isinstance(shape, coal.Cylinder):
        return Core(_ENDS * shape.halfLength, disc=shape.radius)
    return Core(np.empty((0, 3)), filled=False)


def _box_of(points: np.ndarray) -> np.ndarray:
    """The corners of the box along the axes about points (k, 3), shape (8, 3) [m]."""
    corners: np.ndarray = np.where(_SIGNS > 0.0, points.max(axis=0), points.min(axis=0))
    return corners


_SIGNS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
_ENDS = np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])
