"""Coal's shapes: convex hulls of points, trees of triangles, and balls in a form that is safe against these.

Coal and its Qhull crash on hulls of points that are doubled or lie almost in a plane: scaling, `_FLAT` and `_NEAR` keep
such points from them. Vertices of a hull are input points bit for bit; `case_file.py` hands them to the referee.
"""

from __future__ import annotations

from typing import Any

import coal
import numpy as np

from guidefield.geometry.closed import merged_points
from guidefield.geometry.directions import furthest, heights_along, spread_and_axes
from guidefield.geometry.surfaces import Floats, Integers, Surface, surface


def balls_as_capsules(first: Any, second: Any) -> tuple[Any, Any]:
    """Return two Coal shapes, a ball against a mesh as a capsule without length.

    Coal (3.0.3) finds balls in contact with triangles without area at one place in ten, however far they are.
    """
    if isinstance(first, coal.Sphere) and isinstance(second, coal.BVHModelBase):
        return _capsule(first), second
    if isinstance(second, coal.Sphere) and isinstance(first, coal.BVHModelBase):
        return first, _capsule(second)
    return first, second


def replace_balls(geometry: Any) -> Any:
    """Return a pinocchio.GeometryModel, if it has a mesh with its balls as capsules without length."""
    shapes = [shape.geometry for shape in geometry.geometryObjects]
    if not any(isinstance(shape, coal.BVHModelBase) for shape in shapes):
        return geometry
    made = geometry.copy()
    for shape in made.geometryObjects:
        if isinstance(shape.geometry, coal.Sphere):
            shape.geometry = _capsule(shape.geometry)
    return made


def _capsule(ball: Any) -> Any:
    return coal.Capsule(ball.radius, 0.0)


def bvh(vertices: np.ndarray, triangles: np.ndarray) -> Any:
    """Build a Coal tree of oriented boxes over vertices (v, 3) and triangles (t, 3): a surface, no inside."""
    tree = coal.BVHModelOBBRSS()
    tree.beginModel(len(triangles), len(vertices))
    tree.addVertices(np.ascontiguousarray(vertices, float))
    tree.addTriangles(np.ascontiguousarray(triangles, np.int64))
    tree.endModel()
    tree.computeLocalAABB()
    return tree


_FLAT = 1e-11  # least over largest singular value of points, below which they count as lying in a plane

_NEAR = 2.0**-27
"""Side of cells whose points count as one, as a share of the points' spread: about 1e-9 m in a link."""


def convex_hull(points: Floats) -> Surface:
    """Return the convex hull of points (n, 3); its vertices are some of them, bit for bit.

    Raises:
        ValueError: if the points are not of that shape, not finite, or lie in a plane, or if a vertex has more
            neighbours than Coal can count.
    """
    cloud = _distinct(points)
    rounded = _spread_alike(cloud)
    kept = _apart(rounded)
    cloud, rounded = cloud[kept], rounded[kept]
    hull = _hull(rounded)
    _, place = merged_points(np.concatenate([rounded, np.asarray(hull.points())]))
    chosen = place[len(rounded) :]  # all places are those of the points, which are all different
    triangles = np.array([(one[0], one[1], one[2]) for one in map(hull.polygons, range(hull.num_polygons))])
    return surface(cloud[chosen], triangles)


def hull_planes(hull: Surface, most: int) -> Floats:
    """Return planes n.p <= d, shape (t, 4) [m], that touch a hull, for its `most` largest triangles, largest first.

    Every point of the hull is below each, also that of a sliver, whose normal may have any direction.
    """
    a, b, c = np.moveaxis(hull.corners, 1, 0)
    normals = np.cross(b - a, c - a)
    areas = np.linalg.norm(normals, axis=1)
    largest = np.argsort(-areas, kind="stable")[:most]
    normals = normals[largest] / np.maximum(areas[largest], 1e-300)[:, None]
    touched = hull.vertices[furthest(hull.vertices, normals)]
    return np.column_stack([normals, np.einsum("ij,ij->i", normals, touched)])


def convex(vertices: Floats, triangles: np.ndarray) -> Any:
    """Return a hull of vertices (v, 3) and triangles (t, 3) as Coal's shape."""
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


def _spread_alike(cloud: Floats) -> Floats:
    """The points under a linear map that makes them spread alike in all directions.

    Their hull has the same triangles; but on a thin plate itself Qhull gives up, and Coal does not survive that.
    """
    offsets = cloud - cloud.mean(axis=0) if len(cloud) else cloud
    spread, axes = spread_and_axes(offsets)
    if len(cloud) < 4 or spread[2] <= _FLAT * spread[0]:
        raise FlatError(f"a convex hull needs points that do not lie in a plane, got {len(cloud)} different ones")
    turn = np.sign(np.linalg.det(axes))
    scale = turn * np.sqrt(len(cloud)) / spread
    return np.column_stack([heights_along(offsets, factor * axis) for factor, axis in zip(scale, axes, strict=True)])


def _apart(rounded: Floats) -> Integers:
    """Return indices of points, one of those that are within about `_NEAR` of each other.

    The normal of a triangle between points that are d apart is off by a rounding over d. Qhull takes such triangles for
    concave and merges them with others: points stay outside the hull, and Coal does not survive Qhull's warning of it.
    """
    kept = np.arange(len(rounded))
    for shift in (0.0, 0.5):  # what a border of the first cells parts is within one of the second
        kept = kept[merged_points(np.floor(rounded[kept] * (1.0 / _NEAR) + shift))[0]]
    return kept


def _hull(rounded: Floats) -> Any:
    try:
        return coal.Convex.convexHull(_vector(rounded), True, "Qt")
    except RuntimeError as error:
        raise ValueError(f"Coal cannot make the hull of {len(rounded)} points: {error}") from None


def _vector(points: Floats) -> coal.StdVec_Vec3s:
    vector = coal.StdVec_Vec3s()
    for point in points:
        vector.append(point)
    return vector
