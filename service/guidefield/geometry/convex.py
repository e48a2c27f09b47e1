"""The convex hull of points: made by Coal, which does not survive points that are thin or doubled."""

from __future__ import annotations

from typing import Any

import coal
import numpy as np

from guidefield.geometry.closed import merged_points
from guidefield.geometry.surfaces import Floats, Surface, surface

_FLAT = 1e-11
"""Spread across over spread along, below which points count as lying in a plane."""


def convex_hull(points: Floats) -> Surface:
    """Convex hull of points; its vertices are some of them, bit for bit.

    Args:
        points: Shape (n, 3) [m].

    Raises:
        ValueError: if the points are not of that shape, not finite, or lie in a plane, or if a vertex has more
            neighbours than Coal can count.
    """
    cloud = _distinct(points)
    rounded = _rounded(cloud)
    hull = _hull(rounded)
    index = {row.tobytes(): k for k, row in enumerate(rounded)}
    chosen = [index[vertex.tobytes()] for vertex in np.asarray(hull.points())]
    triangles = [[hull.polygons(k)[corner] for corner in range(3)] for k in range(hull.num_polygons)]
    return surface(cloud[chosen], np.array(triangles))


def convex(vertices: Floats, triangles: np.ndarray) -> Any:
    """A hull as Coal's shape.

    Args:
        vertices: Shape (v, 3) [m].
        triangles: Shape (t, 3), as `convex_hull` has them.
    """
    faces = coal.StdVec_Triangle()
    for corners in triangles.tolist():
        faces.append(coal.Triangle(*corners))
    return coal.Convex(_vector(vertices), faces)


class FlatError(ValueError):
    """Points lie in a plane, so that their hull is not a body."""


def _distinct(points: Floats) -> Floats:
    cloud = np.asarray(points, dtype=np.float64)
    if cloud.ndim != 2 or cloud.shape[1] != 3:
        raise ValueError(f"`points` must have shape (n, 3), got {cloud.shape}")
    if not np.isfinite(cloud).all():
        raise ValueError("`points` must be finite")
    distinct: Floats = cloud[merged_points(cloud)[0]]
    return distinct


def _rounded(cloud: Floats) -> Floats:
    """The points under a linear map that makes them spread alike in all directions.

    Their hull has the same triangles; but on a thin plate itself Qhull gives up, and Coal does not survive that.
    """
    offsets = cloud - cloud.mean(axis=0) if len(cloud) else cloud
    _, spread, axes = np.linalg.svd(offsets, full_matrices=False)
    if len(cloud) < 4 or spread[2] <= _FLAT * spread[0]:
        raise FlatError(f"a convex hull needs points that do not lie in a plane, got {len(cloud)} different ones")
    turn = np.sign(np.linalg.det(axes))
    rounded: Floats = turn * offsets @ (axes.T / spread) * np.sqrt(len(cloud))
    return rounded


def _hull(rounded: Floats) -> Any:
    try:
        return coal.Convex.convexHull(_vector(rounded), True, "Qt")
    except RuntimeError as error:
        raise ValueError(f"Coal cannot make the hull of {len(rounded)} points: {error}") from None


def _vector(points: Floats) -> coal.StdVec_Vec3s:
    """Points (n, 3) as Coal takes them."""
    vector = coal.StdVec_Vec3s()
    for point in points:
        vector.append(point)
    return vector
