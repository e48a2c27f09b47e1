"""Directions: spread over the sphere, principal axes of points, and the points that are furthest along some.

Products are kernels or sums by hand, because NumPy hands tall ones to BLAS, whose threads cost more than these loops.
Covers and hulls are chosen by these directions: others give other (as valid) shapes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from guidefield.geometry.surfaces import Floats, Integers
from guidefield.kernels.cover.cut_halves import furthest_along
from guidefield.kernels.linalg.small_systems import principal_axes


def perpendicular_axes(direction: NDArray[np.float64]) -> NDArray[np.float64]:
    """Two unit vectors, shape (2, 3), that make a right-handed frame with a unit vector, shape (3,)."""
    first = np.cross(direction, np.eye(3)[np.abs(direction).argmin()])
    first /= np.linalg.norm(first)
    return np.array([first, np.cross(direction, first)])


def spread_directions(count: int) -> Floats:
    """Unit vectors spread over all directions along a spiral from pole to pole, shape (count, 3)."""
    k = np.arange(count)
    heights, turns = 1.0 - (2.0 * k + 1.0) / count, k * np.pi * (3.0 - np.sqrt(5.0))
    radii = np.sqrt(1.0 - heights**2)
    return np.column_stack([radii * np.cos(turns), radii * np.sin(turns), heights])


def spread_and_axes(offsets: Floats) -> tuple[Floats, Floats]:
    """Singular values (3,) and right singular vectors (3, 3), one in each row, of points (n, 3); the largest first."""
    spread, axes = np.empty(3), np.empty((3, 3))
    principal_axes(np.array(offsets, dtype=np.float64, order="C"), spread, axes)
    return spread, axes


def furthest(points: Floats, directions: Floats) -> Integers:
    """Which of points (n, 3) is furthest in each of some directions (d, 3), shape (d,)."""
    found = np.empty(len(directions), np.int64)
    furthest_along(np.ascontiguousarray(points), np.ascontiguousarray(directions.T), found)
    return found


def heights_along(points: Floats, axis: Floats) -> Floats:
    """How far points (.., 3) are along an axis (3,), shape (..)."""
    x, y, z = axis.tolist()
    heights: Floats = x * points[..., 0] + y * points[..., 1] + z * points[..., 2]
    return heights
