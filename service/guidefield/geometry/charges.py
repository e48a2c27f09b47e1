"""Points spread evenly over a surface, each standing for a share of its area, and a small capsule about points.

Links' charges are made of both (`robot/bodies/charges.py`). The capsule contains the points by a margin for rounding,
whatever the search finds; its constants decide only how small it is. More candidates spread the points more evenly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from guidefield.geometry.directions import furthest, perpendicular_axes, spread_directions
from guidefield.geometry.surfaces import Floats, Integers
from guidefield.kernels.cover.enclosing_circle import SLACK, enclosing_circle
from guidefield.kernels.cover.pieces import farthest_first

_ROUNDING = 16.0 * float(np.finfo(np.float64).eps)
"""The same for points that lie close together far from the origin, over their coordinates."""

_RADII = 1.0 + 0.25 * np.linspace(0.0, 1.0, 11) ** 2
"""Radii to try, as multiples of the least: a wider capsule may be shorter; 1.225 makes a cube's a ball."""

_DIRECTIONS = spread_directions(512)
"""Of many points those furthest in these directions choose the direction of the axis."""

_FIRST_TILT, _LAST_TILT = 0.2, 0.01  # the largest and smallest step of the search for the best direction [rad]


@dataclass(frozen=True, eq=False)
class Capsule:
    """All points within `radius` [m] of the segment from `p0` to `p1`, shape (3,) each [m], which may be one point."""

    p0: Floats
    p1: Floats
    radius: float

    @property
    def volume(self) -> float:
        """Volume [m^3]."""
        length = float(np.linalg.norm(self.p1 - self.p0))
        return np.pi * self.radius**2 * (length + 4.0 / 3.0 * self.radius)

    def distance(self, points: Floats) -> Floats:
        """Return signed distances of points (n, 3) from the surface, shape (n,) [m]; negative inside."""
        axis = self.p1 - self.p0
        square = float(axis @ axis)
        offsets = points - self.p0
        along = np.clip(offsets @ axis / square, 0.0, 1.0) if square > 0.0 else np.zeros(len(points))
        distances: Floats = np.linalg.norm(offsets - along[:, None] * axis, axis=1) - self.radius
        return distances


def fit_capsule(points: Floats) -> Capsule:
    """Find a capsule about points (n, 3), n >= 1, of locally least volume over the directions of its axis.

    The search starts from the best principal axis. ValueError if there is no point, or one is not finite.
    """
    cloud = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    if len(cloud) == 0 or not np.isfinite(cloud).all():
        raise ValueError("a capsule needs at least one point, and all finite")
    few = cloud
    if len(cloud) > len(_DIRECTIONS):
        few = cloud[furthest(cloud, _DIRECTIONS / np.maximum(np.ptp(cloud, axis=0), 1e-9))]
    few = np.unique(few, axis=0)
    centred = few - few.mean(axis=0)
    principal = np.linalg.svd(centred.T @ centred)[2]
    best, direction = _tilt(few, min(principal, key=lambda axis: _along(few, axis).volume))
    return best if len(cloud) <= len(_DIRECTIONS) else _along(cloud, direction)


def _tilt(cloud: Floats, direction: Floats) -> tuple[Capsule, Floats]:
    """The best capsule that tilting the direction, less and less, leads to, and its direction."""
    best = _along(cloud, direction)
    tilt = _FIRST_TILT
    while tilt > _LAST_TILT:
        first, second = perpendicular_axes(direction)
        tilts = [direction + tilt * side for side in (first, -first, second, -second)]
        trials = [(_along(cloud, tilted), tilted) for tilted in (t / np.linalg.norm(t) for t in tilts)]
        trial, tilted = min(trials, key=lambda pair: pair[0].volume)
        if trial.volume < best.volume:
            best, direction = trial, tilted
        else:
            tilt *= 0.5
    return best, direction


def _along(cloud: Floats, direction: Floats) -> Capsule:
    """The capsule of least volume with its axis along a unit direction, through the middle of the enclosing circle."""
    frame = np.vstack([perpendicular_axes(direction), direction])
    local = cloud @ frame.T
    circle = np.empty(3)
    enclosing_circle(np.ascontiguousarray(local[:, :2]), circle)
    centre, radius = circle[:2], float(circle[2])
    radii = radius * _RADII
    # A point is inside if the axis comes to within `reach` of its height.
    squares = ((local[:, :2] - centre) ** 2).sum(axis=1)
    reach = np.sqrt(np.maximum((radii * radii)[:, None] - squares, 0.0))
    low, high = (local[:, 2] + reach).min(axis=1), (local[:, 2] - reach).max(axis=1)
    best = int(np.argmin(radii**2 * (np.maximum(high - low, 0.0) + 4.0 / 3.0 * radii)))
    heights = (low[best], high[best]) if low[best] < high[best] else [0.5 * (low[best] + high[best])] * 2
    ends = np.array([[*centre, height] for height in heights]) @ frame
    ends.setflags(write=False)
    farthest = float(Capsule(ends[0], ends[1], 0.0).distance(cloud).max())
    return Capsule(ends[0], ends[1], farthest * SLACK + _ROUNDING * float(np.abs(cloud).max()))


_CANDIDATES_PER_POINT = 64  # candidates per chosen point: shares of the area come in steps of about its inverse

_LEAST_CANDIDATES = 512

_PLASTIC = 1.324717957244746
"""Root of x^3 = x + 1; its powers spread points in the plane as the golden ratio does on a line."""


@dataclass(frozen=True, eq=False)
class SurfacePoints:
    """Points (n, 3) on a surface with its outward unit normals (n, 3) and their shares of the area (n,) [m^2]."""

    points: Floats
    normals: Floats
    weights: Floats


def surface_points(vertices: Floats, triangles: Integers, spacing: float) -> SurfacePoints:
    """Choose points of a surface, (v, 3) and (t, 3), that keep a spacing [m] and come within it of all of it.

    Farthest point sampling of many candidates that are uniform in area, from the far end of the surface on; each point
    represents the part of the surface nearest to it. ValueError if the area is 0 or the spacing not positive.
    """
    corners = np.asarray(vertices, dtype=np.float64)[np.asarray(triangles)]
    normals = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(normals, axis=1)
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
    result = SurfacePoints(candidates[chosen], normals[of] / areas[of, None], weights)
    for array in (result.points, result.normals, result.weights):
        array.setflags(write=False)
    return result


def _uniform(corners: Floats, areas: Floats, count: int) -> tuple[Floats, Integers]:
    """Return points uniform in area, shape (count, 3), and the triangle of each: equal steps along the summed areas."""
    steps = (np.arange(count) + 0.5) * (areas.sum() / count)
    owners = np.minimum(np.searchsorted(np.cumsum(areas), steps), np.flatnonzero(areas)[-1])
    order = np.arange(1, count + 1)
    s, t = (order / _PLASTIC) % 1.0, (order / _PLASTIC**2) % 1.0
    beyond = s + t > 1.0
    s, t = np.where(beyond, 1.0 - s, s), np.where(beyond, 1.0 - t, t)
    a, b, c = corners[owners].transpose(1, 0, 2)
    return a + s[:, None] * (b - a) + t[:, None] * (c - a), owners


def _farthest_first(candidates: Floats, spacing: float) -> tuple[Integers, Integers]:
    # neighbours stand together along Morton's curve, through a grid of 1024 cells a side
    extent = max(float(np.ptp(candidates, axis=0).max()), 1e-300)
    cells = np.minimum((candidates - candidates.min(axis=0)) * (1024.0 / extent), 1023.0).astype(np.int64)
    bits = range(10)
    code = sum(((cells[:, axis] >> bit) & 1) << (3 * bit + axis) for bit in bits for axis in range(3))
    order = np.argsort(code, kind="stable")
    sorted_candidates = np.ascontiguousarray(candidates[order])
    offsets = sorted_candidates - candidates.mean(axis=0)
    start = int((offsets * offsets).sum(axis=1).argmax())
    chosen, owner = np.empty(len(order), np.int64), np.empty(len(order), np.int64)
    count = farthest_first(sorted_candidates, start, spacing, chosen, owner)
    return order[chosen[:count]], np.bincount(owner, minlength=count)
