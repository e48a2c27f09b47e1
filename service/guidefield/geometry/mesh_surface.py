"""Classify a triangle mesh: closed or open, consistent or not, convex, or a box; turn it outwards and tell its faults.

What a mesh counts as decides what is collision: a solid's inside is, an open surface has none. Scenes, links and the
cases for the referee are judged by the same surface. So all tolerances enter verdicts; `_CHUNK` is time alone. The
warnings are sentences that users read.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from guidefield.geometry.closed import (
    are_proper,
    compact,
    crack_lids,
    crossings,
    edge_counts,
    find_connected,
    numbered_edges,
    seams,
    volume,
)
from guidefield.geometry.convex import convex, convex_hull
from guidefield.geometry.surfaces import Surface, extents

_FLAT = 1e-9  # a closed mesh with less volume than this fraction of its size cubed has no inside
_CHUNK = 4096  # triangles that are examined first or together, before all others; above 0
_CONVEX = 1e-7  # how far a mesh may dent in and still be judged by its hull, as a fraction of its size


@dataclass(frozen=True, eq=False)
class MeshSurface:
    """A triangle mesh as it is judged."""

    vertices: np.ndarray  # distinct vertices that triangles use, shape (v, 3) [m]
    triangles: np.ndarray  # shape (t, 3), counter-clockwise from outside where the mesh is solid
    solid: bool  # whether it is closed around a volume
    hull: Any | None  # its convex hull as a Coal shape if it is that hull, else None
    warnings: tuple[str, ...]  # open, inside out, inconsistent; one sentence each


class Joined(NamedTuple):
    """A mesh with merged vertices (v, 3), proper triangles (t, 3) with their given indices (t,), and its `seams`."""

    vertices: np.ndarray
    triangles: np.ndarray
    given: np.ndarray
    seams: np.ndarray
    width: float  # of the widest crack [m]
    edges: tuple[np.ndarray, int]  # as of `numbered_edges`

    @property
    def welded(self) -> np.ndarray:
        """The triangles with the cracks closed by `seams`, without those that lose a corner by that, shape (k, 3)."""
        if self.width == 0.0:
            return self.triangles
        corners = self.seams[self.triangles]
        welded: np.ndarray = corners[are_proper(corners)]
        return welded


def join_mesh(vertices: np.ndarray, triangles: np.ndarray) -> Joined:
    """Merge the vertices (v, 3) of triangles (t, 3), and find the cracks between these."""
    distinct, corners, given = compact(vertices, triangles)
    edges = numbered_edges(corners)
    return Joined(distinct, corners, given, *seams(distinct, corners, numbered=edges), edges)


def mesh_surface(vertices: np.ndarray, triangles: np.ndarray) -> MeshSurface | None:
    """Judge a mesh of vertices (v, 3) and triangles (t, 3); None if its triangles have no area.

    Cracks between corners at most `WIDEST_CRACK` apart are closed by thin lids, as long as nothing else is open. Where
    the mesh is closed then, triangles that face inwards are turned.
    """
    return surface_of(join_mesh(vertices, triangles))


def surface_of(mesh: Joined) -> MeshSurface | None:
    """Do what `mesh_surface` does for a mesh whose vertices are merged."""
    vertices = mesh.vertices
    if not has_area(vertices, mesh.triangles):
        return None
    triangles, solid, warnings = _facing_outwards(mesh)
    hull = own_hull(vertices, mesh._replace(triangles=triangles).welded) if solid else None
    if solid and mesh.width > 0.0:
        triangles = np.concatenate([triangles, crack_lids(triangles, mesh.seams)])
        warnings.append(f"its surface had cracks up to {1000.0 * mesh.width:.2g} mm wide, which were closed")
    for array in (vertices, triangles):
        array.setflags(write=False)
    return MeshSurface(vertices, triangles, solid, hull, tuple(warnings))


def crossing_warnings(mesh: Joined) -> tuple[str, ...]:
    """Return a sentence on triangles that cross each other, by the indices they are given with; nothing if none do.

    Those that overlap at a crack alone don't count.
    """
    found = crossings(mesh.vertices, mesh.welded)
    warnings = []
    if len(found.pairs):
        given = mesh.given[are_proper(mesh.seams[mesh.triangles])]
        count = f"{len(found.pairs)} pairs" if len(found.pairs) > 1 else "1 pair"
        least = "" if found.complete else "at least "
        first, second = given[found.pairs[0]]
        warnings.append(f"it intersects itself: {least}{count} of its triangles cross, such as {first} and {second}")
    if not found.complete:
        warnings.append("it is too large to look for all places where it intersects itself")
    return tuple(warnings)


def has_area(vertices: np.ndarray, triangles: np.ndarray) -> bool:
    """Check that one of the triangles (t, 3) of vertices (v, 3) has an area."""
    least = 1e-12 * extents(vertices).max() ** 2 if len(triangles) else 0.0
    for start in range(0, len(triangles), _CHUNK):
        a, b, c = (vertices[column] for column in triangles[start : start + _CHUNK].T)
        if 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).max() > least:
            return True
    return False


def _edges(triangles: np.ndarray) -> np.ndarray:
    """Directed edges (3 t, 2): edge i of every triangle, then edge i + 1."""
    return np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])


def _facing_outwards(mesh: Joined) -> tuple[np.ndarray, bool, list[str]]:
    """Return triangles, turned where that makes a closed mesh consistent; whether it is solid; warnings.

    The mesh is examined with its cracks closed.
    """
    vertices, triangles, welded = mesh.vertices, mesh.triangles, mesh.welded
    if not len(welded):
        return triangles, False, ["it is as small as a crack: it is judged as a thin wall"]
    forward, backward = edge_counts(welded, mesh.edges if mesh.width == 0.0 else None)
    warnings = []
    if not np.array_equal(forward, backward):
        open_edges = int(((forward + backward) == 1).sum())
        if open_edges:
            fault = f"its surface is open ({open_edges} edges belong to one triangle): it is judged as a thin wall"
            return triangles, False, [fault]
        consistent = _turn_alike(vertices, welded) if ((forward + backward) == 2).all() else None
        if consistent is None:
            return triangles, False, ["its triangles can't be turned to face outwards: it is judged as a thin wall"]
        proper = np.flatnonzero(are_proper(mesh.seams[triangles]))
        turned = proper[(consistent != welded).any(axis=1)]
        warnings.append(f"{len(turned)} of its triangles faced inwards and were turned")
        triangles = triangles.copy()
        triangles[turned] = triangles[turned][:, ::-1]
        welded = consistent
    enclosed = volume(vertices, welded)
    if abs(enclosed) <= _FLAT * np.linalg.norm(extents(vertices)) ** 3:
        return triangles, False, [*warnings, "it is closed around no volume: it is judged as a thin wall"]
    if enclosed < 0.0:
        if not warnings:
            warnings.append("its triangles ran clockwise from outside and were turned")
        triangles = triangles[:, ::-1]
    return np.ascontiguousarray(triangles), True, warnings


def _turn_alike(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray | None:
    """Turn triangles so that neighbours agree, piece by piece; None if the surface has only one side.

    Every edge must belong to two triangles. Every piece of the result encloses a positive volume, so that a hollow in
    another piece counts as filled: the safe side, where nobody can tell any more.
    """
    edges, count = _edges(triangles), len(triangles)
    order = np.lexsort(np.sort(edges, axis=1).T)
    pairs = order.reshape(-1, 2)
    same_way = edges[pairs[:, 0], 0] == edges[pairs[:, 1], 0]
    neighbours: list[list[tuple[int, bool]]] = [[] for _ in range(count)]
    for (first, second), disagree in zip((pairs % count).tolist(), same_way.tolist(), strict=True):
        neighbours[first].append((second, disagree))
        neighbours[second].append((first, disagree))
    flipped: list[bool | None] = [None] * count
    turned = triangles.copy()
    for root in range(count):
        if flipped[root] is not None:
            continue
        piece = _flip_from(root, neighbours, flipped)
        if piece is None:
            return None
        wrong = [triangle for triangle in piece if flipped[triangle]]
        turned[wrong] = turned[wrong][:, ::-1]
        if volume(vertices, turned[piece]) < 0.0:
            turned[piece] = turned[piece][:, ::-1]
    return turned


def _flip_from(root: int, neighbours: list[list[tuple[int, bool]]], flipped: list[bool | None]) -> list[int] | None:
    """Decide for the piece of a triangle which of its triangles to flip; the piece, or None on a contradiction."""
    flipped[root] = False
    piece, waiting = [root], deque([root])
    while waiting:
        here = waiting.popleft()
        for there, disagree in neighbours[here]:
            wanted = flipped[here] != disagree
            if flipped[there] is None:
                flipped[there] = wanted
                piece.append(there)
                waiting.append(there)
            elif flipped[there] != wanted:
                return None
    return piece


def own_hull(vertices: np.ndarray, triangles: np.ndarray) -> Any | None:
    """Return the hull of vertices (v, 3) if a solid, outward mesh (t, 3) is that: one piece, no dent, its volume."""
    size, first = float(np.linalg.norm(extents(vertices))), _first_ones(vertices, triangles)
    if _is_dented(vertices, first, _CONVEX * size):
        return None
    forward, backward = edge_counts(triangles)
    if not ((forward == 1) & (backward == 1)).all():
        return None
    pieces = np.unique(find_connected(len(vertices), triangles)[triangles])
    if len(pieces) > 1 or (len(first) < len(triangles) and _is_dented(vertices, triangles, _CONVEX * size)):
        return None
    try:
        around = convex_hull(vertices)
    except ValueError:  # it is flat, or too fine for Coal
        return None
    enclosed = volume(around.vertices, around.triangles)
    if abs(enclosed - volume(vertices, triangles)) > 1e-6 * enclosed:
        return None
    return hull_shape(around)


def hull_shape(around: Surface) -> Any:
    """Return a hull as Coal's shape, with its box."""
    hull = convex(around.vertices, around.triangles)
    hull.computeLocalAABB()
    return hull


def _first_ones(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return the first triangles and those that share a vertex with them: most dented surfaces are dented there."""
    marked = np.zeros(len(vertices), bool)
    marked[triangles[:_CHUNK]] = True
    a, b, c = triangles.T
    few: np.ndarray = triangles[marked[a] | marked[b] | marked[c]]
    return few


def _is_dented(vertices: np.ndarray, triangles: np.ndarray, deepest: float) -> bool:
    """Check whether a triangle's far vertex is more than `deepest` above its neighbour's plane [m].

    Edges of one triangle only don't count; an edge of more than two, which none of a hull is, may count or not.
    """
    edges, count = _edges(triangles), len(triangles)
    opposite = np.concatenate([triangles[:, 2], triangles[:, 0], triangles[:, 1]])
    keys = edges.min(axis=1) * len(vertices) + edges.max(axis=1)
    order = np.argsort(keys, kind="stable")
    at = np.flatnonzero(keys[order[1:]] == keys[order[:-1]])
    pairs = np.column_stack([order[at], order[at + 1]])
    a, b, c = (vertices[column] for column in triangles.T)
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    first, second = pairs.T
    heights = np.einsum("ij,ij->i", normals[first % count], vertices[opposite[second]] - vertices[edges[first, 0]])
    return bool(heights.max(initial=-np.inf) > deepest)


class SolidBox(NamedTuple):
    """A solid that is a box within the arithmetic: a box that contains it."""

    rotation: np.ndarray  # its axes as columns, shape (3, 3)
    centre: np.ndarray  # shape (3,) [m]
    halves: np.ndarray  # half extents along them, shape (3,) [m]


def find_boxes(vertices: np.ndarray, solids: Sequence[np.ndarray]) -> list[SolidBox | None]:
    """Find the solids that are boxes of 12 triangles.

    Args:
        vertices: Shape (v, 3) [m].
        solids: The triangles of each, counter-clockwise from outside, shape (t, 3).
    """
    found: list[SolidBox | None] = [None] * len(solids)
    some = [k for k, one in enumerate(solids) if len(one) == 12 and len(np.unique(one)) == 8]
    if not some:
        return found
    triangles = vertices[np.array([solids[k] for k in some])]
    corners = vertices[np.array([np.unique(solids[k]) for k in some])]
    rows, centres = np.arange(len(some)), corners.mean(axis=1)
    edges = corners[:, 1:] - corners[:, :1]
    lengths, square = np.linalg.norm(edges, axis=2), np.ones(edges.shape[:2], bool)
    sides = np.empty((len(some), 3, 3))
    for side in range(3):  # from a corner, the shortest edge that is across those before
        sides[:, side] = edges[rows, np.where(square, lengths, np.inf).argmin(axis=1)]
        along = np.abs(np.einsum("nek,nk->ne", edges, sides[:, side])) / np.linalg.norm(sides[:, side], axis=1)[:, None]
        square &= along < _RIGHT_ANGLE * lengths
    x = sides[:, 2] / np.linalg.norm(sides[:, 2], axis=1)[:, None]
    y = sides[:, 1] - np.einsum("nk,nk->n", sides[:, 1], x)[:, None] * x
    with np.errstate(invalid="ignore", divide="ignore"):
        y /= np.linalg.norm(y, axis=1)[:, None]
    rotations = np.stack([x, y, np.cross(x, y)], axis=2)
    own = np.einsum("nvk,nkj->nvj", corners - centres[:, None], rotations)
    halves = np.abs(own).max(axis=1)
    off = np.abs(np.abs(own) - halves[:, None]).max(axis=(1, 2))
    is_box = off <= _CONVEX * np.maximum(2.0 * np.linalg.norm(halves, axis=1), np.abs(corners).max(axis=(1, 2)))
    is_box &= (np.sort((own > 0.0) @ [1, 2, 4], axis=1) == np.arange(8)).all(axis=1)
    about = triangles - centres[:, None, None]
    enclosed = np.einsum("ntk,ntk->n", about[:, :, 0], np.cross(about[:, :, 1], about[:, :, 2])) / 6.0
    is_box &= np.abs(enclosed - 8.0 * halves.prod(axis=1)) <= _VOLUME_TOLERANCE * enclosed
    for row in np.flatnonzero(is_box).tolist():
        found[some[row]] = SolidBox(rotations[row], centres[row], halves[row])
    return found


_RIGHT_ANGLE = 1e-2
"""Edges at a corner of a box are perpendicular if the cosine of their angle is less; the box is made to hold all."""

_VOLUME_TOLERANCE = 1e-3  # by which share a solid's volume may differ from that of the box about it
