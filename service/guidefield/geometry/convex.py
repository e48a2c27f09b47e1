"""Convex hulls, trees of triangles and of balls about them, and polytopes with few vertices about points.

Coal and its Qhull crash on hulls of points that are doubled or lie almost in a plane: scaling, `_FLAT` and `_NEAR` keep
such points from them. Vertices of a hull are input points bit for bit; `case_file.py` hands them to the referee.

The tree is laid out by counts alone (`cluster_counts`, `count_boxed`), so that tables of a large mesh are allocated
before it is written (`collision/batch/surface_tables.py`, `collision/part_tables.py`). Balls contain their triangles,
polytopes their points. `CLUSTERS` (ascending) and `BOXED` are time, and which distance within its tolerance a search
finds; `MOST_VERTICES` is also how closely convex parts fit (`decomposition.py`), which streams' proofs rest on.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import coal
import numpy as np

from guidefield.geometry.closed import merged_points
from guidefield.geometry.surfaces import (
    Floats,
    Integers,
    Surface,
    furthest,
    heights_along,
    spread_and_axes,
    spread_directions,
    surface,
)
from guidefield.kernels.distance.bvh import balls_about_runs, halve_runs


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


MOST_VERTICES = 192  # a hull with more gives way to a polytope about it with about as many

CLUSTERS = (5, 21, 85)
"""The first nodes on the way down with no more triangles than one of these are its clusters.

Their corners, padded to 16, 64 or 256, are tested as a polytope's points; `CLUSTER` of surface_tables.py picks one.
"""

Cluster = tuple[np.ndarray, np.ndarray]  # nodes, shape (k,), and the triangles below each, shape (k, most)

BOXED = 2048
"""Nodes of more triangles than clusters have, and of no more than this, may get a box. With 8192 distances take a tenth
less time, without any twice as long, on a ring of a million triangles about a Panda."""

OnNodes = Callable[[Cluster], None]  # receives the nodes that may get a box, with their triangles


@dataclass(frozen=True, eq=False)
class MeshTree:
    """Triangles and a binary tree over them."""

    corners: np.ndarray  # shape (t, 3, 3) [m], in the mesh's frame
    balls: np.ndarray  # centre and radius of the ball about each node, shape (n, 4) [m]; the root is the first
    links: np.ndarray  # children and triangle of each node, shape (n, 3); -1 where there is none
    # for each of `CLUSTERS` the nodes, shape (k,), and the triangles below each, shape (k, most): one of them fills
    # the rest
    clusters: tuple[Cluster, ...]
    # vertices of a polytope about them all, shape (k, 3) [m]; None where they are in a plane
    hull: np.ndarray | None = None


def mesh_tree(triangles: np.ndarray, hull: np.ndarray | None = None) -> MeshTree:
    """Build the tree over triangles (t, 3, 3), with a polytope about them: that of vertices (k, 3) or their hull."""
    if hull is None and len(triangles) > 1:
        try:
            hull = polytope_about(np.array(convex_hull(triangles.reshape(-1, 3)).vertices))
        except ValueError:  # it is flat
            hull = None
    return replace(triangle_tree(triangles), hull=hull)


def triangle_tree(triangles: np.ndarray) -> MeshTree:
    """The tree over triangles (t, 3, 3), each group halved along its widest side; without a polytope about them all."""
    nodes = 2 * len(triangles) - 1
    return write_tree(triangles, np.empty((nodes, 4)), np.empty((nodes, 3), np.int64))


def cluster_counts(triangles: int) -> list[int]:
    """Count the nodes of a `triangle_tree` over a given number of triangles that are of each of `CLUSTERS`."""
    sizes = _node_sizes(triangles)
    return [sum(many for (size, above), many in sizes.items() if 1 < size <= most < above) for most in CLUSTERS]


def count_boxed(triangles: int) -> int:
    """Count the nodes of a `triangle_tree` over a given number of triangles that may get a box, see `BOXED`."""
    return sum(many for (size, _), many in _node_sizes(triangles).items() if CLUSTERS[-1] < size <= BOXED)


def _node_sizes(triangles: int) -> Counter[tuple[int, int]]:
    """Count the nodes of a tree by the triangles below each, and below the node above; the root has none above."""
    found = Counter[tuple[int, int]]()
    level = Counter({(triangles, triangles + CLUSTERS[-1]): 1})
    while level:
        found += level
        below = Counter[tuple[int, int]]()
        for (size, _), many in level.items():
            for half in (size // 2, size - size // 2) if size > 1 else ():
                below[half, size] += many
        level = below
    return found


def write_tree(
    triangles: np.ndarray,
    balls: np.ndarray,
    links: np.ndarray,
    boxed: OnNodes = lambda _: None,
    counts: np.ndarray | None = None,
) -> MeshTree:
    """Write a `triangle_tree` in balls (2 t - 1, 4) and links (2 t - 1, 3); tell which nodes may get a box.

    If `counts`, shape (n,), are given, the triangles are those of n meshes, one behind the other: a forest, whose nodes
    stand level by level, the roots first.
    """
    triangles = np.ascontiguousarray(triangles, float)
    centres, members = (triangles[:, 0] + triangles[:, 1] + triangles[:, 2]) / 3.0, np.arange(len(triangles))
    sizes, made = np.array([len(triangles)]) if counts is None else counts, 0
    above = np.full(len(sizes), np.iinfo(np.int64).max)
    found: list[list[Cluster]] = [[] for _ in CLUSTERS]
    while len(sizes):  # level by level: the members of its nodes one after the other
        starts = np.concatenate([[0], np.cumsum(sizes)[:-1]])
        level = slice(made, made + len(sizes))
        balls_about_runs(triangles, members, starts, sizes, balls[level])
        for most, nodes in zip(CLUSTERS, found, strict=True):
            first = np.flatnonzero((sizes > 1) & (sizes <= most) & (above > most))
            nodes.append((made + first, _runs(members, starts[first], sizes[first], most)))
        large = np.flatnonzero((sizes > CLUSTERS[-1]) & (sizes <= BOXED))
        if len(large):
            boxed((made + large, _runs(members, starts[large], sizes[large], int(sizes[large].max()))))
        split = sizes > 1
        children = level.stop + 2 * np.cumsum(split) - 2
        rows = links[level]
        rows[:, 0], rows[:, 1] = np.where(split, children, -1), np.where(split, children + 1, -1)
        rows[:, 2] = np.where(split, -1, members[starts])
        members = members if split.all() else members[np.repeat(split, sizes)]
        halve_runs(centres, np.cumsum(sizes[split]) - sizes[split], sizes[split], members)
        made = level.stop
        above = np.repeat(sizes[split], 2)
        halves = sizes[split] // 2
        sizes = np.column_stack([halves, sizes[split] - halves]).ravel()
    clusters = tuple(
        (np.concatenate(nodes), np.concatenate(rows)) for nodes, rows in (zip(*f, strict=True) for f in found)
    )
    return MeshTree(triangles, balls, links, clusters)


def mesh_of_nodes(counts: np.ndarray) -> np.ndarray:
    """Return the mesh of each node of a forest over meshes of given sizes, shape (n,): level by level, (m,)."""
    found, meshes, sizes = list[np.ndarray](), np.arange(len(counts)), counts
    while len(sizes):
        found.append(meshes)
        split = sizes > 1
        meshes, halves = np.repeat(meshes[split], 2), sizes[split] // 2
        sizes = np.column_stack([halves, sizes[split] - halves]).ravel()
    return np.concatenate([np.empty(0, np.int64), *found])


def _runs(members: np.ndarray, starts: np.ndarray, sizes: np.ndarray, most: int) -> np.ndarray:
    """Return runs of members as rows (n, most), the last of each repeated."""
    rows: np.ndarray = members[starts[:, None] + np.minimum(np.arange(most), sizes[:, None] - 1)]
    return rows


def polytope_about(vertices: np.ndarray) -> np.ndarray:
    """Return the vertices (k, 3) of a polytope about points (n, 3) that aren't in a plane; if they are few, the points.

    It is bounded by planes that touch the points, spread over all directions: its dual is the hull of their normals,
    each over its plane's distance from a point inside.
    """
    if len(vertices) <= MOST_VERTICES:
        return vertices
    centre = vertices.mean(axis=0)
    _, axes = spread_and_axes(vertices - centre)
    local = np.stack([heights_along(vertices - centre, axis) for axis in axes], axis=1)
    spread = np.ptp(local, axis=0)
    local /= spread
    normals = spread_directions(MOST_VERTICES // 2 + 2)
    heights = np.einsum("ij,ij->i", local[furthest(local, normals)], normals)
    dual = convex_hull(normals / (heights * (1.0 + 1e-6))[:, None])
    corners = dual.vertices[dual.triangles]
    # a facet of the dual lies in the plane x.v = 1 of a vertex v
    found: np.ndarray = np.linalg.solve(corners, np.ones((len(corners), 3, 1)))[..., 0] * spread @ axes + centre
    return found
