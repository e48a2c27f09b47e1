"""The free part of a plane about a point: rays in all directions until they hit, and the polygon that they leave."""

from __future__ import annotations

import math

import numpy as np
from numba import types, void

from guidefield.kernels.distance.distance import TABLES, DistanceTables, bodies_near, nearest_body
from guidefield.kernels.jit.signatures import (
    BLOCKS,
    MATRIX,
    MATRIX_OUT,
    SCALAR,
    VECTOR,
    VECTOR_OUT,
    Floats,
    Integers,
    compiled,
    inlined,
)

_NEAR = 0.0025
"""A ray hits what is nearer than this, as a share of the longest."""


@inlined
def _ray_length(
    tables: DistanceTables, centre: Floats, u: Floats, v: Floats, angle: float, longest: float, candidates: Integers,
    count: int,
) -> float:  # fmt: skip
    """Return the length of a ray in a plane before it hits one of some obstacles [m]."""
    c, s = math.cos(angle), math.sin(angle)
    dx, dy, dz = c * u[0] + s * v[0], c * u[1] + s * v[1], c * u[2] + s * v[2]
    t = 0.0
    while t < longest:
        x, y, z = centre[0] + t * dx, centre[1] + t * dy, centre[2] + t * dz
        free = nearest_body(x, y, z, candidates, count, tables, longest)[0]
        if free < _NEAR * longest:
            return t
        t += free
    return longest


@inlined
def _ray_lengths(
    tables: DistanceTables, centre: Floats, u: Floats, v: Floats, longest: float, candidates: Integers, lengths: Floats
) -> None:
    """Return how far evenly spread rays in a plane get before they hit an obstacle [m]."""
    count = bodies_near(centre[0], centre[1], centre[2], longest, tables, candidates)  # nothing else can be hit
    rays = lengths.shape[0]
    for k in range(rays):
        lengths[k] = _ray_length(tables, centre, u, v, 2.0 * math.pi * k / rays, longest, candidates, count)


@compiled(types.boolean(TABLES, VECTOR, BLOCKS, SCALAR, types.int64))
def is_enclosed(tables: DistanceTables, centre: Floats, axes: Floats, longest: float, rays: int) -> bool:
    """Tell if in one of some planes through a point every ray hits an obstacle.

    Args:
        tables: The obstacles.
        centre: The point, shape (3,) [m].
        axes: Two unit vectors of each plane, across each other, shape (n, 2, 3).
        longest: No ray is followed farther [m].
        rays: How many there are.
    """
    candidates = np.empty(tables.kinds.shape[0], np.int64)
    count = bodies_near(centre[0], centre[1], centre[2], longest, tables, candidates)
    for i in range(axes.shape[0]):
        k = 0
        while k < rays:
            angle = 2.0 * math.pi * k / rays
            if _ray_length(tables, centre, axes[i, 0], axes[i, 1], angle, longest, candidates, count) >= longest:
                break
            k += 1
        if k == rays:
            return True
    return False


@compiled(void(TABLES, MATRIX, BLOCKS, SCALAR, types.int64, VECTOR_OUT))
def open_areas(
    tables: DistanceTables, centres: Floats, axes: Floats, longest: float, rays: int, areas_out: Floats
) -> None:
    """Return how much of planes about points is seen from there [m^2].

    Args:
        tables: The obstacles.
        centres: The points, shape (n, 3) [m].
        axes: Two unit vectors of each plane, across each other, shape (n, 2, 3).
        longest: No ray is followed farther [m].
        rays: How many there are.
        areas_out: Areas between the rays, shape (n,).
    """
    candidates, lengths = np.empty(tables.kinds.shape[0], np.int64), np.empty(rays)
    for i in range(centres.shape[0]):
        _ray_lengths(tables, centres[i], axes[i, 0], axes[i, 1], longest, candidates, lengths)
        total = 0.0
        for k in range(rays):
            total += lengths[k - 1] * lengths[k]
        areas_out[i] = 0.5 * math.sin(2.0 * math.pi / rays) * total


@inlined
def _cut(corners: Floats, count: int, nx: float, ny: float, offset: float, cut: Floats) -> int:
    """Cut a convex polygon by a half-plane ``n . x <= offset`` that reaches into it; return its count of corners."""
    kept = 0
    bx, by = corners[count - 1, 0], corners[count - 1, 1]
    before = nx * bx + ny * by - offset
    for k in range(count):
        x, y = corners[k, 0], corners[k, 1]
        here = nx * x + ny * y - offset
        if before * here < 0.0:
            share = before / (before - here)
            cut[kept, 0], cut[kept, 1] = bx + share * (x - bx), by + share * (y - by)
            kept += 1
        if here <= 0.0:
            cut[kept, 0], cut[kept, 1] = x, y
            kept += 1
        bx, by, before = x, y, here
    for k in range(kept):
        corners[k, 0], corners[k, 1] = cut[k, 0], cut[k, 1]
    return kept


@compiled(types.int64(TABLES, VECTOR, MATRIX, SCALAR, MATRIX_OUT))
def free_section(tables: DistanceTables, centre: Floats, axes: Floats, longest: float, corners_out: Floats) -> int:
    """A convex polygon about a point that is free as far as rays tell: cut at the nearest hits first.

    Args:
        tables: The obstacles.
        centre: The point, shape (3,) [m].
        axes: Two unit vectors of the plane, across each other, shape (2, 3).
        longest: No ray is followed farther [m].
        corners_out: Corners in those axes about the point, counter-clockwise [m]; room for twice as many as there are
            rays, shape (2 rays, 2).

    Returns:
        How many corners there are.
    """
    rays = corners_out.shape[0] // 2
    candidates, lengths = np.empty(tables.kinds.shape[0], np.int64), np.empty(rays)
    cut = np.empty((2 * rays, 2))
    _ray_lengths(tables, centre, axes[0], axes[1], longest, candidates, lengths)
    for k in range(rays):
        angle = 2.0 * math.pi * k / rays
        corners_out[k, 0], corners_out[k, 1] = longest * math.cos(angle), longest * math.sin(angle)
    count = rays
    order = np.argsort(lengths, kind="mergesort")
    for k in order:
        if lengths[k] < longest:
            angle = 2.0 * math.pi * k / rays
            count = _cut(corners_out, count, math.cos(angle), math.sin(angle), lengths[k], cut)
    return int(count)
