"""A triangle mesh as a tree of balls, cut into pieces that are nearly convex."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from guidefield.geometry.convex import convex_hull

MOST_PIECES = 8
"""Most pieces of a mesh."""

MOST_VERTICES = 64
"""A hull with more gives way to a polytope about it with about as many."""

_DEEPEST = 500
"""Pieces are looked for among about as many nodes."""

LEAST_GAIN = 0.03
"""A piece is halved if the hulls of its halves are smaller than its own by this share, together."""


@dataclass(frozen=True, eq=False)
class MeshTree:
    """Triangles and a binary tree over them.

    Attributes:
        corners: Shape (t, 3, 3) [m].
        balls: Ball about each node, shape (n, 4); the root is the first.
        links: Children and triangle of each node, shape (n, 3); -1 where there is none.
        hulls: Vertices of a polytope about what is below a node, by node; of pieces and of what is above them.
        pieces: Nodes that together hold all triangles, each nearly filling its hull.
    """

    corners: np.ndarray
    balls: np.ndarray
    links: np.ndarray
    hulls: dict[int, np.ndarray]
    pieces: np.ndarray


def mesh_tree(triangles: np.ndarray, most: int = MOST_PIECES) -> MeshTree:
    """Build the tree over triangles (t, 3, 3), each group halved along its widest side; at most so many pieces."""
    centres, members = triangles.mean(axis=1), np.arange(len(triangles))
    sizes = np.array([len(triangles)])
    balls, links, made = [], np.empty((0, 3), np.int64), 0
    below: list[np.ndarray] = []
    while len(sizes):  # level by level: the members of its nodes one after the other
        starts = np.concatenate([[0], np.cumsum(sizes)[:-1]])
        balls.append(_balls_about(triangles[members], starts, sizes))
        if len(below) < _DEEPEST:
            below += np.split(members, starts[1:])
        split = sizes > 1
        children = made + len(sizes) + 2 * np.cumsum(split) - 2
        rows = np.column_stack([np.where(split, children, -1), np.where(split, children + 1, -1), members[starts]])
        rows[split, 2] = -1
        links = np.concatenate([links, rows])
        members = _halved(centres, members[np.repeat(split, sizes)], sizes[split])
        made += len(sizes)
        halves = sizes[split] // 2
        sizes = np.column_stack([halves, sizes[split] - halves]).ravel()
    return MeshTree(triangles, np.concatenate(balls), links, *_cut(triangles, links, below, most))


def _cut(
    triangles: np.ndarray, links: np.ndarray, below: list[np.ndarray], most: int
) -> tuple[dict[int, np.ndarray], np.ndarray]:
    """Hulls by node, and the nodes that are pieces: what gains most is halved first, while that gains anything.

    `below` holds the triangles below each of the first nodes.
    """
    hulls: dict[int, np.ndarray] = {}
    volumes: dict[int, float] = {}

    def measured(node: int) -> float:
        if node not in volumes:
            try:
                hull = convex_hull(triangles[below[node]].reshape(-1, 3))
            except ValueError:  # flat
                volumes[node] = 0.0
            else:
                hulls[node] = np.array(hull.vertices)
                volumes[node] = float(np.linalg.det(hulls[node][hull.triangles] - hulls[node].mean(axis=0)).sum() / 6.0)
        return volumes[node]

    def gain(node: int) -> float:
        left, right = links[node, :2].tolist()
        if left < 0 or right >= len(below):
            return 0.0
        whole = measured(node)
        saved = whole - measured(left) - measured(right)
        return saved if saved > LEAST_GAIN * whole else 0.0

    measured(0)
    pieces, halved = {0: gain(0) if most > 1 else 0.0}, set[int]()
    while len(pieces) < most:
        node = max(pieces, key=lambda one: pieces[one])
        if pieces.pop(node) <= 0.0:
            pieces[node] = 0.0
            break
        halved.add(node)
        pieces.update({child: gain(child) for child in links[node, :2].tolist()})
    chosen = sorted(node for node in halved | set(pieces) if node in hulls)
    return {node: _with_few_vertices(hulls[node]) for node in chosen}, np.array(sorted(pieces))


def _with_few_vertices(vertices: np.ndarray) -> np.ndarray:
    """Vertices of a polytope about points (n, 3) that aren't in a plane: they themselves, if they are few.

    Else it is bounded by planes that touch them, spread over all directions: its dual is the hull of their normals,
    each over its plane's distance from a point inside.
    """
    if len(vertices) <= MOST_VERTICES:
        return vertices
    centre = vertices.mean(axis=0)
    _, _, axes = np.linalg.svd(vertices - centre, full_matrices=False)
    local = (vertices - centre) @ axes.T
    spread = np.ptp(local, axis=0)
    local /= spread
    k = np.arange(MOST_VERTICES // 2 + 2)
    heights, turns = 1.0 - (2.0 * k + 1.0) / len(k), k * np.pi * (3.0 - np.sqrt(5.0))
    across = np.sqrt(1.0 - heights**2)
    normals = np.column_stack([across * np.cos(turns), across * np.sin(turns), heights])
    dual = convex_hull(normals / ((local @ normals.T).max(axis=0) * (1.0 + 1e-6))[:, None])
    corners = dual.vertices[dual.triangles]
    # a facet of the dual lies in the plane x.v = 1 of a vertex v
    found: np.ndarray = np.linalg.solve(corners, np.ones((len(corners), 3, 1)))[..., 0] * spread @ axes + centre
    return found


def _balls_about(triangles: np.ndarray, starts: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """A ball (n, 4) about each of n runs of triangles."""
    low, high = np.minimum.reduceat(triangles.min(axis=1), starts), np.maximum.reduceat(triangles.max(axis=1), starts)
    middles = 0.5 * (low + high)
    apart = np.linalg.norm(triangles - np.repeat(middles, sizes, axis=0)[:, None], axis=2).max(axis=1)
    return np.column_stack([middles, np.maximum.reduceat(apart, starts)])


def _halved(centres: np.ndarray, members: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """The members of runs, each run in order along the side where its centres spread most."""
    if not len(sizes):
        return members
    starts = np.concatenate([[0], np.cumsum(sizes)[:-1]])
    places = centres[members]
    widest = np.argmax(np.maximum.reduceat(places, starts) - np.minimum.reduceat(places, starts), axis=1)
    along = places[np.arange(len(members)), np.repeat(widest, sizes)]
    ordered: np.ndarray = members[np.lexsort((along, np.repeat(np.arange(len(sizes)), sizes)))]
    return ordered
