"""A coarse way for the tip alone through the free space, and what is free across it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from guidefield.kernels.distance import DistanceTables, distance_at_points
from guidefield.kernels.wavefront import CAP, ray_lengths, wavefront

SPACING = 0.05
"""Of the grid [m]."""
MOST_POINTS = 2_000_000
"""The grid is made coarser where it would have more."""
AROUND = 0.3
"""How far the grid reaches beyond obstacles, start and goal [m]."""
COMFORTS = (0.2, 0.1, 0.05, 0.02)
"""Clearance at which a way costs twice its length [m]: ways with much of it are looked for first."""
SMOOTHINGS = 8
PUSH = 0.3
"""Share of what is missing to free clearance by which a point of the way is pushed off the obstacles."""
RAYS = 24
LONGEST = 0.4
"""Rays are followed no farther [m]: a plane in the open is this large."""


@dataclass(frozen=True, eq=False)
class TipWay:
    """Points of a way, about evenly spaced.

    Attributes:
        points: Shape (n, 3) [m, world].
        tangents: Unit vectors along it, shape (n, 3).
        clearances: Distance to obstacles, at most `CAP`, shape (n,) [m].
    """

    points: np.ndarray
    tangents: np.ndarray
    clearances: np.ndarray


def tip_way(
    tables: DistanceTables, start: np.ndarray, goal: np.ndarray, radius: float, centre: np.ndarray, reach: float
) -> TipWay | None:
    """The way of the tip with most clearance for its length; None if there is none.

    Args:
        tables: The obstacles.
        start: Where the tip is, shape (3,) [m].
        goal: Where it is to be, shape (3,) [m].
        radius: Of the tip's body [m].
        centre: What the tip can't be farther from than `reach`, shape (3,) [m].
        reach: See `centre` [m]; may be infinite.
    """
    low, high = _box(tables, start, goal, centre, reach)
    spacing = max(SPACING, float(np.cbrt(np.prod(high - low) / MOST_POINTS)))
    low = start - spacing * np.ceil((start - low) / spacing)  # the start is a point of the grid
    counts = np.ceil((high - low) / spacing).astype(np.int64) + 1
    first, last = (np.rint((end - low) / spacing).astype(np.int64) for end in (start, goal))
    ends = clearances(tables, np.array([start, low + spacing * last]))
    floor = float(min(radius, 0.5 * ends.min()))
    if floor <= 0.0:
        return None
    found = np.empty(int(np.prod(counts)), np.int64)
    free = np.full(len(found), np.nan, np.float32)
    best: np.ndarray | None = None
    for comfort in COMFORTS:
        n = wavefront(tables, low, spacing, counts, first, last, comfort, floor, centre, reach, free, found)
        if n < 2:
            return None
        points = low + spacing * np.stack(np.unravel_index(found[:n][::-1], tuple(counts)), axis=1)
        best = points if best is None else best
        if _can_follow(points, centre, reach):
            best = points
            break
    assert best is not None, "there is at least one comfort"
    best[-1] = goal
    return _smoothed(tables, best)


def _can_follow(points: np.ndarray, centre: np.ndarray, reach: float) -> bool:
    """Whether an arm that lies along a way, from where the way is nearest to its base, would be long enough."""
    nearest = int(np.argmin(np.linalg.norm(points - centre, axis=1)))
    along = float(np.linalg.norm(np.diff(points[nearest:], axis=0), axis=1).sum())
    return float(np.linalg.norm(points[nearest] - centre)) + along <= reach


def section(tables: DistanceTables, centre: np.ndarray, across: np.ndarray) -> np.ndarray:
    """What is free in a plane about a point: corners (k, 2) of a convex polygon, counter-clockwise, along `across`.

    Cut from a wide one at the nearest hits of rays first, so that what is cut away is small.

    Args:
        tables: The obstacles.
        centre: The point, shape (3,) [m].
        across: Two unit vectors of the plane, shape (2, 3).
    """
    lengths = _rays(tables, centre, across)
    angles = 2.0 * np.pi * np.arange(RAYS) / RAYS
    rays = np.column_stack([np.cos(angles), np.sin(angles)])
    polygon = LONGEST * rays
    for k in np.argsort(lengths, kind="stable"):
        if lengths[k] < LONGEST:
            polygon = _cut(polygon, rays[k], float(lengths[k]))
    return polygon


def open_area(tables: DistanceTables, centre: np.ndarray, across: np.ndarray) -> float:
    """How much of a plane about a point is seen from there [m^2]; see `section` for the arguments."""
    lengths = _rays(tables, centre, across)
    return 0.5 * float(np.sin(2.0 * np.pi / RAYS) * (lengths @ np.roll(lengths, -1)))


def centroid(polygon: np.ndarray) -> np.ndarray:
    """Centroid (2,) of a polygon (k, 2) with an area."""
    after = np.roll(polygon, -1, axis=0)
    cross = polygon[:, 0] * after[:, 1] - polygon[:, 1] * after[:, 0]
    middle: np.ndarray = ((polygon + after) * cross[:, None]).sum(axis=0) / (3.0 * cross.sum())
    return middle


def clearances(tables: DistanceTables, points: np.ndarray) -> np.ndarray:
    """Distance of points (n, 3) to the obstacles, at most `CAP`, shape (n,) [m]."""
    clear: np.ndarray = np.minimum(distance_at_points(tables, points, CAP)[0], CAP)
    return clear


def _rays(tables: DistanceTables, centre: np.ndarray, across: np.ndarray) -> np.ndarray:
    lengths = np.empty(RAYS)
    ray_lengths(tables, centre, np.ascontiguousarray(across[0]), np.ascontiguousarray(across[1]), LONGEST, lengths)
    return lengths


def _cut(polygon: np.ndarray, normal: np.ndarray, offset: float) -> np.ndarray:
    """What a half-plane ``normal . x <= offset`` leaves of a convex polygon that it reaches into."""
    heights = polygon @ normal - offset
    if heights.max() <= 0.0:
        return polygon
    corners = []
    for k in range(len(polygon)):
        here, there = heights[k - 1], heights[k]
        if here * there < 0.0:
            corners.append(polygon[k - 1] + here / (here - there) * (polygon[k] - polygon[k - 1]))
        if there <= 0.0:
            corners.append(polygon[k])
    return np.array(corners)


def _box(
    tables: DistanceTables, start: np.ndarray, goal: np.ndarray, centre: np.ndarray, reach: float
) -> tuple[np.ndarray, np.ndarray]:
    """Corners of a box about obstacles and both ends, and no larger than the reach."""
    low, high = np.minimum(start, goal) - AROUND, np.maximum(start, goal) + AROUND
    if len(tables.nodes):
        low, high = np.minimum(low, tables.nodes[0, :3] - AROUND), np.maximum(high, tables.nodes[0, 3:] + AROUND)
    if np.isfinite(reach):
        low, high = np.maximum(low, centre - reach), np.minimum(high, centre + reach)
        low, high = np.minimum(low, np.minimum(start, goal)), np.maximum(high, np.maximum(start, goal))
    return low, high


def _smoothed(tables: DistanceTables, points: np.ndarray) -> TipWay:
    """The way as a band: drawn straight, pushed off the obstacles; no point of it loses clearance."""
    least = 0.98 * clearances(tables, points)
    for _ in range(SMOOTHINGS):
        distances, away, _ = distance_at_points(tables, points, CAP)
        tangents = _tangents(points)
        away -= np.einsum("ij,ij->i", away, tangents)[:, None] * tangents
        moved = points.copy()
        moved[1:-1] = 0.25 * points[:-2] + 0.5 * points[1:-1] + 0.25 * points[2:]
        moved[1:-1] += (PUSH * (CAP - np.minimum(distances, CAP))[:, None] * away)[1:-1]
        keeps = clearances(tables, moved) >= least
        points = np.where(keeps[:, None], moved, points)
    return TipWay(points, _tangents(points), clearances(tables, points))


def _tangents(points: np.ndarray) -> np.ndarray:
    """Unit vectors (n, 3) along points, from the second before to the second after each."""
    at = np.arange(len(points))
    along = points[np.minimum(at + 2, len(points) - 1)] - points[np.maximum(at - 2, 0)]
    tangents: np.ndarray = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    return tangents
