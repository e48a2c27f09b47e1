"""A triangle mesh as a binary tree of balls, with its clusters; polytopes with few vertices about points.

The tree is laid out by counts alone (`cluster_counts`, `count_boxed`), so that tables of a large mesh are allocated
before it is written (`collision/lanes/surface_tables.py`, `collision/part_tables.py`). Balls contain their triangles.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from guidefield.geometry.convex import convex_hull
from guidefield.geometry.directions import furthest, heights_along, spread_and_axes, spread_directions
from guidefield.kernels.distance.bvh import balls_about_runs, halve_runs

MOST_VERTICES = 192  # a hull with more gives way to a polytope about it with about as many


CLUSTERS = (5, 21, 85)
"""The first nodes on the way down with no more triangles than one of these are its clusters.

Their corners, padded to 16, 64 or 256, are tested as the points of a polytope.
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
