"""Balls inside of boxes, cylinders, capsules and spheres, in the shape's own frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from guidefield.geometry import surfaces
from guidefield.geometry.inner import LEAST_RADIUS, MOST, SAFETY, inner_balls
from guidefield.geometry.solid import solid
from guidefield.geometry.surfaces import Floats

_SIDES = 36
"""Of the prism within a cylinder."""


def inner_sphere(radius: float) -> Floats:
    """The sphere itself; shape (n, 4) [m], as for the other shapes."""
    return _row(0.0, radius)


def inner_capsule(radius: float, length: float) -> Floats:
    """Balls along the axis of a capsule, z, in its own frame.

    Args:
        radius: Of the capsule [m].
        length: Of its straight part [m].

    Returns:
        Centres and radii, shape (n, 4) [m].
    """
    return _row(0.5 * length, radius)


def inner_cylinder(radius: float, length: float) -> Floats:
    """Balls inside of a cylinder with flat ends along z, in its own frame.

    Args:
        radius: Of the cylinder [m].
        length: From end to end [m].

    Returns:
        Centres and radii, shape (n, 4) [m].
    """
    if 0.5 * length >= radius:
        return _row(0.5 * length - radius, radius)
    # the prism's sides touch a cylinder of radius r, its edges one of r / cos(pi / sides)
    return inner_balls(solid(*surfaces.cylinder(radius * np.cos(np.pi / _SIDES), length, _SIDES)))


def inner_box(size: ArrayLike) -> Floats:
    """Balls inside of a box about the origin; `size` is its full extents, shape (3,) [m]."""
    return inner_balls(solid(*surfaces.box(size)))


def _row(half: float, radius: float) -> Floats:
    """Equal balls from -half to half along z, about a radius apart if they needn't be more than `MOST`."""
    inside = radius - SAFETY
    count = int(np.clip(np.ceil(2.0 * half / radius) + 1, 1, MOST)) if inside >= LEAST_RADIUS else 0
    heights = np.linspace(-half, half, count) if count > 1 else np.zeros(count)
    balls = np.column_stack([np.zeros((count, 2)), heights, np.full(count, inside)])
    balls.setflags(write=False)
    return balls
