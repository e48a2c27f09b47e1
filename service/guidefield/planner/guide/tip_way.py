"""A coarse way for the tip alone through the free space, and what is free across it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from guidefield.kernels.distance.distance import DistanceTables, distance_at_points
from guidefield.kernels.guide.grid_astar import CAP, wavefront
from guidefield.kernels.guide.visibility_polygon import free_section, is_enclosed, open_areas as open_areas_kernel
from guidefield.planner.guide.settings import TIP_WAY
from guidefield.read_only import ReadOnly
from guidefield.scene.flat import axes_across


@dataclass(frozen=True, eq=False)
class TipWay(ReadOnly):
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
    tables: DistanceTables, start: np.ndarray, goal: np.ndarray, radius: float, centre: np.ndarray, reach: float,
    ample: float = CAP,
) -> TipWay | None:  # fmt: skip
    """The way of the tip with most clearance for its length; None if there is none.

    If there is one that an arm is long enough to lie along, it is one of those.

    Args:
        tables: The obstacles.
        start: Where the tip is, shape (3,) [m, world].
        goal: Where it is to be, shape (3,) [m, world].
        radius: Of the tip's body [m].
        centre: What the tip can't be farther from than `reach`, shape (3,) [m, world].
        reach: See `centre` [m]; may be infinite.
        ample: Clearance beyond which more is worth no detour [m].
    """
    low, high = _box(tables, start, goal, centre, reach)
    spacing = max(TIP_WAY.spacing, float(np.cbrt(np.prod(high - low) / TIP_WAY.most_points)))
    low = start - spacing * np.ceil((start - low) / spacing)  # the start is a point of the grid
    counts = np.ceil((high - low) / spacing).astype(np.int64) + 1
    first, last = (np.rint((end - low) / spacing).astype(np.int64) for end in (start, goal))
    ends = clearances(tables, np.array([start, low + spacing * last]))
    floor = float(min(radius, 0.5 * ends.min()))
    if floor <= 0.0:
        return None
    found = np.empty(int(np.prod(counts)), np.int64)
    free = np.full(len(found), np.nan, np.float32)
    ample = float(np.clip(ample, TIP_WAY.least_ample, CAP))
    for comfort, arm in (*((comfort, reach) for comfort in TIP_WAY.comforts), (TIP_WAY.comforts[0], np.inf)):
        n = wavefront(tables, low, spacing, counts, first, last, comfort, ample, floor, centre, reach, arm, free, found)
        if n >= 2:
            points = low + spacing * np.stack(np.unravel_index(found[:n][::-1], tuple(counts)), axis=1)
            points[-1] = goal
            return _smoothed(tables, points)
    return None


def section(tables: DistanceTables, centre: np.ndarray, across: np.ndarray) -> np.ndarray:
    """What is free in a plane about a point: corners (k, 2) of a convex polygon, counter-clockwise, along `across`.

    Cut from a wide one at the nearest hits of rays first, so that what is cut away is small.

    Args:
        tables: The obstacles.
        centre: The point, shape (3,) [m].
        across: Two unit vectors of the plane, shape (2, 3).
    """
    corners = np.empty((2 * TIP_WAY.rays, 2))
    return corners[: free_section(tables, centre, across, TIP_WAY.longest, corners)]


def open_areas(tables: DistanceTables, centres: np.ndarray, across: np.ndarray) -> np.ndarray:
    """How much of planes about points is seen from there, shape (n,) [m^2].

    Args:
        tables: The obstacles.
        centres: The points, shape (n, 3) [m].
        across: Two unit vectors of each plane, shape (n, 2, 3).
    """
    areas = np.empty(len(centres))
    open_areas_kernel(tables, centres, across, TIP_WAY.longest, TIP_WAY.compared_rays, areas)
    return areas


def enclosed(tables: DistanceTables, point: np.ndarray, normals: np.ndarray) -> bool:
    """Whether a point (3,) is in a passage: in one of the planes with unit normals (n, 3) all rays from it hit."""
    across = np.array([axes_across(normal) for normal in normals])
    return is_enclosed(tables, point, across, TIP_WAY.longest, TIP_WAY.compared_rays)


def clearances(tables: DistanceTables, points: np.ndarray) -> np.ndarray:
    """Distance of points (n, 3) to the obstacles, at most `CAP`, shape (n,) [m]."""
    clear: np.ndarray = np.minimum(distance_at_points(tables, points, CAP)[0], CAP)
    return clear


def _box(
    tables: DistanceTables, start: np.ndarray, goal: np.ndarray, centre: np.ndarray, reach: float
) -> tuple[np.ndarray, np.ndarray]:
    """Corners of a box about obstacles and both ends, and no larger than the reach."""
    around = TIP_WAY.around
    low, high = np.minimum(start, goal) - around, np.maximum(start, goal) + around
    if len(tables.nodes):
        low, high = np.minimum(low, tables.nodes[0, :3] - around), np.maximum(high, tables.nodes[0, 3:] + around)
    if np.isfinite(reach):
        low, high = np.maximum(low, centre - reach), np.minimum(high, centre + reach)
        low, high = np.minimum(low, np.minimum(start, goal)), np.maximum(high, np.maximum(start, goal))
    return low, high


def _smoothed(tables: DistanceTables, points: np.ndarray) -> TipWay:
    """The way as a band: drawn straight, pushed off the obstacles; no point of it loses clearance."""
    least = TIP_WAY.kept * clearances(tables, points)
    for _ in range(TIP_WAY.smoothings):
        distances, away, _ = distance_at_points(tables, points, CAP)
        tangents = _tangents(points)
        away -= np.einsum("ij,ij->i", away, tangents)[:, None] * tangents
        moved = points.copy()
        moved[1:-1] = 0.25 * points[:-2] + 0.5 * points[1:-1] + 0.25 * points[2:]
        moved[1:-1] += (TIP_WAY.push * (CAP - np.minimum(distances, CAP))[:, None] * away)[1:-1]
        keeps = clearances(tables, moved) >= least
        points = np.where(keeps[:, None], moved, points)
    return TipWay(points, _tangents(points), clearances(tables, points))


def _tangents(points: np.ndarray) -> np.ndarray:
    """Unit vectors (n, 3) along points, from the second before to the second after each."""
    at = np.arange(len(points))
    along = points[np.minimum(at + 2, len(points) - 1)] - points[np.maximum(at - 2, 0)]
    tangents: np.ndarray = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    return tangents
