"""The free part of a plane about a point: rays in all directions until they hit, and the polygon that they leave.

`planner/guide/auto_planes.py` makes guide planes of it. Between rays obstacles may be missed: planes guide, they prove
nothing.
"""

from __future__ import annotations

import math

import numpy as np

from guidefield.kernels.distance.distance import DistanceTables, bodies_near, nearest_body
from guidefield.kernels.jit.arrays import Blocks, Floats, Integers, Row, RowOut, Rows, RowsOut
from guidefield.kernels.jit.decorators import inlined, kernel
from guidefield.kernels.linalg.small_systems import write_stable_order

_NEAR = 0.0025  # a ray hits what is nearer than this, as a share of the longest


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
    """Write the lengths of evenly spread rays in a plane before they hit an obstacle [m]."""
    count = bodies_near(centre[0], centre[1], centre[2], longest, tables, candidates)  # nothing else can be hit
    rays = lengths.shape[0]
    for k in range(rays):
        lengths[k] = _ray_length(tables, centre, u, v, 2.0 * math.pi * k / rays, longest, candidates, count)


@kernel
def is_enclosed(tables: DistanceTables, centre: Row, axes: Blocks, longest: float, rays: int) -> bool:
    """Tell if in one of some planes through a point (3,) each of `rays` rays hits an obstacle within `longest` [m].

    `axes` (n, 2, 3) are two unit vectors of each plane, across each other.
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


@kernel
def open_areas(
    tables: DistanceTables, centres: Rows, axes: Blocks, longest: float, rays: int, areas_out: RowOut
) -> None:
    """Write how much (n,) of planes about points (n, 3) is seen from there by rays no longer than `longest` [m^2].

    `axes` (n, 2, 3) are two unit vectors of each plane, across each other.
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


@kernel
def free_section(tables: DistanceTables, centre: Row, axes: Rows, longest: float, corners_out: RowsOut) -> int:
    """Cut a convex polygon about a point (3,) that is free as far as rays tell: what all their hits leave.

    Returns the count of corners, which are in the plane's unit vectors `axes` (2, 3), counter-clockwise [m];
    `corners_out` (2 rays, 2); no ray exceeds `longest` [m].
    """
    rays = corners_out.shape[0] // 2
    candidates, lengths = np.empty(tables.kinds.shape[0], np.int64), np.empty(rays)
    cut = np.empty((2 * rays, 2))
    _ray_lengths(tables, centre, axes[0], axes[1], longest, candidates, lengths)
    for k in range(rays):
        angle = 2.0 * math.pi * k / rays
        corners_out[k, 0], corners_out[k, 1] = longest * math.cos(angle), longest * math.sin(angle)
    count = rays
    order = np.empty(rays, np.int64)
    write_stable_order(lengths, order)
    for k in order:
        if lengths[k] < longest:
            angle = 2.0 * math.pi * k / rays
            count = _cut(corners_out, count, math.cos(angle), math.sin(angle), lengths[k], cut)
    return int(count)
