"""Points spread evenly over a surface, each standing for a share of its area."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from guidefield.geometry.surfaces import Floats, Integers
from guidefield.kernels.cover.farthest import farthest_first

_CANDIDATES_PER_POINT = 64
"""Candidates per chosen point: shares of the area come in steps of about its inverse."""

_LEAST_CANDIDATES = 512

_PLASTIC = 1.324717957244746
"""Root of x^3 = x + 1; its powers spread points in the plane as the golden ratio does on a line."""


@dataclass(frozen=True, eq=False)
class SurfacePoints:
    """Points on a surface; arrays are read-only.

    Attributes:
        points: Shape (n, 3) [m].
        normals: Outward unit normals of the triangles they lie on, shape (n, 3).
        weights: Area that each stands for, shape (n,) [m^2]; their sum is the surface's area.
    """

    points: Floats
    normals: Floats
    weights: Floats


def surface_points(vertices: Floats, triangles: Integers, spacing: float) -> SurfacePoints:
    """Points that keep `spacing` from each other and come to within it of all the surface.

    The first is at the far end of the surface, every next one farthest from those before (farthest point sampling
    of many candidates that are uniform in area); each stands for the part of the surface that is nearest to it.
    The same surface gives the same points.

    Args:
        vertices: Shape (v, 3) [m].
        triangles: Indices into `vertices`, counter-clockwise from outside, shape (t, 3).
        spacing: Least distance between two points [m]; to less than it a share of the surface extends.

    Raises:
        ValueError: if the surface has no area or the spacing is not positive.
    """
    corners = np.asarray(vertices, dtype=np.float64)[np.asarray(triangles)]
    across = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(across, axis=1)
    area = float(areas.sum())
    if not (area > 0.0 and np.isfinite(area)):
        raise ValueError(f"a surface to put points on needs a finite area, got {area} m^2")
    if not (spacing > 0.0 and np.isfinite(spacing)):
        raise ValueError(f"`spacing` must be positive, got {spacing} m")
    count = max(_LEAST_CANDIDATES, int(np.ceil(_CANDIDATES_PER_POINT * area / spacing**2)))
    candidates, owners = _uniform(corners, areas, count)
    chosen, shares = _farthest_first(candidates, spacing)
    of = owners[chosen]
    weights = shares.astype(np.float64) * (area / count)
    result = SurfacePoints(candidates[chosen], across[of] / areas[of, None], weights)
    for array in (result.points, result.normals, result.weights):
        array.setflags(write=False)
    return result


def _uniform(corners: Floats, areas: Floats, count: int) -> tuple[Floats, Integers]:
    """Points uniform in area, shape (count, 3), and the triangle of each: equal steps along the summed areas."""
    steps = (np.arange(count) + 0.5) * (areas.sum() / count)
    owners = np.minimum(np.searchsorted(np.cumsum(areas), steps), np.flatnonzero(areas)[-1])
    order = np.arange(1, count + 1)
    s, t = (order / _PLASTIC) % 1.0, (order / _PLASTIC**2) % 1.0
    beyond = s + t > 1.0
    s, t = np.where(beyond, 1.0 - s, s), np.where(beyond, 1.0 - t, t)
    a, b, c = corners[owners].transpose(1, 0, 2)
    return a + s[:, None] * (b - a) + t[:, None] * (c - a), owners


def _farthest_first(candidates: Floats, spacing: float) -> tuple[Integers, Integers]:
    """Indices of the chosen candidates, and how many candidates are nearest to each."""
    order = _along_a_curve(candidates)
    sorted_candidates = np.ascontiguousarray(candidates[order])
    offsets = sorted_candidates - candidates.mean(axis=0)
    start = int((offsets * offsets).sum(axis=1).argmax())
    chosen, owner = np.empty(len(order), np.int64), np.empty(len(order), np.int64)
    count = farthest_first(sorted_candidates, start, spacing, chosen, owner)
    return order[chosen[:count]], np.bincount(owner, minlength=count)


def _along_a_curve(points: Floats) -> Integers:
    """An order in which neighbours are near each other: Morton's curve, through a grid of 1024 cells a side."""
    extent = float(np.ptp(points, axis=0).max())
    cells = np.minimum((points - points.min(axis=0)) * (1024.0 / max(extent, 1e-300)), 1023.0).astype(np.int64)
    code = np.zeros(len(points), np.int64)
    for bit in range(10):
        for axis in range(3):
            code |= ((cells[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.argsort(code, kind="stable")
