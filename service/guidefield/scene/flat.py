"""Flat polygons in space: their plane, coordinates in it, and what may be wrong with them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from guidefield.geometry.vectors import cross
from guidefield.kernels.distance.touching_edges import touching_edges

PLANARITY = 1e-6
"""How far from their plane the corners of a flat polygon may lie, as a fraction of its size."""

SMALLEST_AREA = 1e-9
"""Smallest area of a polygon, as a fraction of its size squared."""


@dataclass(frozen=True, eq=False)
class FlatPolygon:
    """Corners in the plane that fits them best.

    Attributes:
        vertices: Corners, shape (k, 3) [m, world].
        normal: Unit normal, shape (3,), about which the corners turn counter-clockwise (as a whole).
        origin: Mean of the corners, shape (3,) [m, world]: the plane runs through it.
        axes: Two unit vectors in the plane, shape (2, 3); ``axes[0] x axes[1] = normal``.
        corners: The vertices in those axes about the origin, shape (k, 2) [m].
        size: Diagonal of the box about the corners [m].
        deviation: Largest distance of a corner from the plane [m].
        area: Signed sum of the enclosed area [m^2]; positive for a simple polygon.
    """

    vertices: np.ndarray
    normal: np.ndarray
    origin: np.ndarray
    axes: np.ndarray
    corners: np.ndarray
    size: float
    deviation: float
    area: float

    def from_plane(self, corners: np.ndarray) -> np.ndarray:
        """Points in the world, shape (n, 3) [m], of points in the plane.

        Args:
            corners: In the plane's axes about its origin, shape (n, 2) [m].
        """
        points: np.ndarray = self.origin + corners @ self.axes
        return points


def centroid(polygon: np.ndarray) -> np.ndarray:
    """Centroid (2,) of a polygon (k, 2) with an area."""
    after = np.roll(polygon, -1, axis=0)
    cross = polygon[:, 0] * after[:, 1] - polygon[:, 1] * after[:, 0]
    middle: np.ndarray = ((polygon + after) * cross[:, None]).sum(axis=0) / (3.0 * cross.sum())
    return middle


def flat_polygon(vertices: np.ndarray) -> FlatPolygon:
    """Fit a plane to the corners of a polygon.

    The normal is Newell's, half the sum of the cross products of successive corners: exact for a flat polygon, convex
    or not, however many corners lie on one line.

    Args:
        vertices: Corners in order, shape (k, 3) [m, world].
    """
    origin = vertices.mean(axis=0)
    arms = vertices - origin
    area_vector = 0.5 * np.cross(arms, np.roll(arms, -1, axis=0)).sum(axis=0)
    area = float(np.linalg.norm(area_vector))
    normal = area_vector / area if area > 0.0 else np.array([0.0, 0.0, 1.0])
    axes = axes_across(normal)
    values = {
        "vertices": np.array(vertices, float),
        "normal": normal,
        "origin": origin,
        "axes": axes,
        "corners": arms @ axes.T,
    }
    for array in values.values():
        array.setflags(write=False)
    return FlatPolygon(
        **values,
        size=float(np.linalg.norm(np.ptp(vertices, axis=0))),
        deviation=float(np.abs(arms @ normal).max()),
        area=area,
    )


def flatness_fault(polygon: FlatPolygon) -> str | None:
    """What keeps corners from being a flat polygon with an area, or None."""
    edges = np.linalg.norm(np.roll(polygon.vertices, -1, axis=0) - polygon.vertices, axis=1)
    if polygon.size == 0.0 or edges.min() <= PLANARITY * polygon.size:
        first = int(np.argmin(edges))
        return f"vertices {first} and {(first + 1) % len(edges)} coincide ({edges[first]:.3g} m apart)"
    if polygon.area <= SMALLEST_AREA * polygon.size**2:
        return f"its area is {polygon.area:.3g} m^2 at a size of {polygon.size:.3g} m: it is a line"
    if polygon.deviation > PLANARITY * polygon.size:
        return (
            f"its vertices lie up to {polygon.deviation:.3g} m off a plane,"
            f" at most {PLANARITY * polygon.size:.3g} m ({PLANARITY:g} of its size) are allowed"
        )
    return None


def axes_across(normal: np.ndarray) -> np.ndarray:
    """Two unit vectors, shape (2, 3), that complete a unit normal, shape (3,), to a right-handed frame."""
    seed = np.zeros(3)
    seed[np.argmin(np.abs(normal))] = 1.0
    first = cross(seed, normal)
    first /= np.linalg.norm(first)
    return np.array([first, cross(normal, first)])


def crossing_edges(polygon: FlatPolygon) -> tuple[int, int] | None:
    """Two edges that touch though they aren't neighbours, or fold back on each other; None if the polygon is simple.

    Edge i runs from corner i to corner i + 1. Lengths below `PLANARITY` of the size count as touching.
    """
    start = polygon.corners
    end = np.roll(start, -1, axis=0)
    count = len(start)
    gap = PLANARITY * polygon.size
    along = (end - start) / np.linalg.norm(end - start, axis=1, keepdims=True)
    cosine = np.einsum("ij,ij->i", along, np.roll(along, -1, axis=0))
    folded = np.flatnonzero(cosine < -1.0 + 0.5 * PLANARITY**2)
    if len(folded):
        return int(folded[0]), int((folded[0] + 1) % count)
    boxes = np.hstack([np.minimum(start, end), np.maximum(start, end)])
    one, other = touching_edges(start, boxes, np.argsort(boxes[:, 0]), gap).tolist()
    return None if one == count else (one, other)


def bulges(corners: np.ndarray) -> bool:
    """Whether an outline turns left at every corner.

    Args:
        corners: Shape (k, 2), counter-clockwise.
    """
    leaving = np.roll(corners, -1, axis=0) - corners
    arriving = np.roll(leaving, 1, axis=0)
    return bool(np.all(arriving[:, 0] * leaving[:, 1] > arriving[:, 1] * leaving[:, 0]))
