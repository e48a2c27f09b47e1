"""Close surfaces of triangles: merge vertices, number edges, fill gaps and cracks by lids, find connected pieces.

No vertex moves: lids are added, so what a closed mesh contains is as it was given. Whether a mesh counts as closed, for
collisions and for proofs alike, depends on `WIDEST_CRACK` and on the exact comparison of places.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from guidefield.geometry.surfaces import Floats, Integers
from guidefield.kernels.cover.merge_points import lowest_connected, merge_points
from guidefield.kernels.cover.small_surfaces import count_ways, number_edges
from guidefield.kernels.cover.winding import signed_volume
from guidefield.kernels.distance.triangle_rows import triangle_boxes


def numbered_edges(triangles: Integers) -> tuple[Integers, int]:
    """Number the edges of triangles (t, 3), whichever way they are run through; return also how many there are.

    The numbers are those of ab, bc and ca of each triangle, shape (3 t,), ascending with the edge's lower vertex, then
    with the other one.
    """
    numbers = np.empty(triangles.size, np.int64)
    count = number_edges(np.ascontiguousarray(triangles, np.int64), int(triangles.max(initial=-1)) + 1, numbers)
    return numbers, count


def edge_counts(triangles: Integers, numbered: tuple[Integers, int] | None = None) -> tuple[Integers, Integers]:
    """Count how often each numbered edge of triangles (t, 3) is run through upwards, and downwards."""
    numbers, count = numbered or numbered_edges(triangles)
    up, down = np.zeros(count, np.int64), np.zeros(count, np.int64)
    count_ways(np.ascontiguousarray(triangles, np.int64), numbers, up, down)
    return up, down


def compact(vertices: Floats, triangles: Integers) -> tuple[Floats, Integers, Integers]:
    """Merge vertices (v, 3) at the same place, and leave out triangles (t, 3) that are none then, and unused vertices.

    Returns:
        Vertices (w, 3), triangles (u, 3), and the given index of each triangle, shape (u,).

    Raises:
        ValueError: if a vertex is not finite.
    """
    vertices = np.asarray(vertices, dtype=np.float64) + 0.0  # so that 0 and -0 are the same place
    if not np.isfinite(vertices).all():
        raise ValueError("`vertices` must be finite")
    first, index = merged_points(vertices)
    merged = vertices[first]
    corners = np.take(index, np.asarray(triangles, dtype=np.int64).reshape(-1, 3))
    a, b, c = corners.T
    proper = (a != b) & (b != c) & (c != a)
    kept = np.flatnonzero(proper)
    return *drop_unused(merged, corners if len(kept) == len(corners) else corners[kept]), kept


def merged_points(points: Floats) -> tuple[Integers, Integers]:
    """Merge points (n, 3) at the same place; 0 and -0 are the same.

    Returns:
        The first point of each place, ascending, shape (k,); the place of each point among these, shape (n,).
    """
    words = (np.ascontiguousarray(points, np.float64) + 0.0).view(np.uint64).reshape(-1, 3)
    place, first = np.empty(len(words), np.int64), np.empty(len(words), np.int64)
    count = merge_points(words, place, first)
    return first[:count], place


def drop_unused(vertices: Floats, triangles: Integers) -> tuple[Floats, Integers]:
    """The vertices (v, 3) that triangles (t, 3) use, in their order, and the triangles of these."""
    used = np.zeros(len(vertices), bool)
    used[triangles] = True
    if used.all():
        return vertices, triangles
    return vertices[used], np.take(np.cumsum(used) - 1, triangles)


def closing_lids(vertices: Floats, triangles: Integers) -> tuple[Integers, float]:
    """Close a surface, shapes (v, 3) and (t, 3), by a fan (n, 3) for each connected part of its boundary.

    The boundary are the edges run through more often in one direction. It has no boundary itself: what comes to a
    vertex leaves it. So the sides of a fan cancel, whatever its apex. Also returned: the largest extent of a part [m],
    or 0.
    """
    edges = boundary(triangles)
    if not len(edges):
        return np.empty((0, 3), np.int64), 0.0
    used, local = np.unique(edges, return_inverse=True)
    labels = find_connected(len(used), local.reshape(-1, 2))
    fans = np.column_stack([used[labels[local.reshape(-1, 2)[:, 0]]], edges[:, 1], edges[:, 0]])
    low, high = np.full((len(used), 3), np.inf), np.full((len(used), 3), -np.inf)
    np.minimum.at(low, labels, vertices[used])
    np.maximum.at(high, labels, vertices[used])
    parts = np.unique(labels)
    extent = float(np.linalg.norm(high[parts] - low[parts], axis=1).max())
    return fans[(fans[:, 0] != fans[:, 1]) & (fans[:, 0] != fans[:, 2])], extent


def find_connected(count: int, simplices: Integers) -> Integers:
    """For each of `count` vertices the lowest one that edges or triangles (n, k) connect it to, shape (count,)."""
    labels = np.empty(count, np.int64)
    lowest_connected(np.ascontiguousarray(simplices, np.int64), labels)
    return labels


def volume(vertices: Floats, triangles: Integers) -> float:
    """Return the volume within a closed surface, shapes (v, 3) and (t, 3) [m^3]; negative if it is inside out."""
    return volumes(vertices, [triangles])[0]


def volumes(vertices: Floats, pieces: Sequence[Integers]) -> list[float]:
    """Return the volumes of several closed surfaces (t, 3) that share vertices (v, 3)."""
    vertices = np.ascontiguousarray(vertices, float)
    about = vertices.mean(axis=0)
    return [float(signed_volume(vertices, np.ascontiguousarray(one, np.int64), about)) for one in pieces]


def boxes_about(vertices: Floats, pieces: Sequence[Integers]) -> Floats:
    """Return the boxes about surfaces (t, 3), t >= 1, that share vertices (v, 3): two corners each, (n, 2, 3)."""
    if not pieces:
        return np.empty((0, 2, 3))
    triangles = np.concatenate(pieces)
    boxes, ends = np.empty((len(triangles), 6)), np.cumsum([len(one) for one in pieces])
    triangle_boxes(np.ascontiguousarray(vertices, float), np.ascontiguousarray(triangles, np.int64), boxes)
    starts = np.concatenate([[0], ends[:-1]])
    low, high = np.minimum.reduceat(boxes[:, :3], starts), np.maximum.reduceat(boxes[:, 3:], starts)
    return np.stack([low, high], axis=1)


def boundary(triangles: Integers) -> Integers:
    """Return the edges (n, 2) of triangles (t, 3), each repeated by its surplus in this direction."""
    numbered = numbers, count = numbered_edges(triangles)
    up, down = edge_counts(triangles, numbered)
    surplus = up - down
    sides = np.flatnonzero(surplus[numbers])
    start, end = triangles.ravel()[sides], triangles[sides // 3, (sides + 1) % 3]
    low, high = np.zeros(count, np.int64), np.zeros(count, np.int64)
    low[numbers[sides]], high[numbers[sides]] = np.minimum(start, end), np.maximum(start, end)
    forward = np.where(surplus > 0, low, high), np.where(surplus > 0, high, low)
    edges_of_it: Integers = np.repeat(np.column_stack(forward), np.abs(surplus), axis=0)
    return edges_of_it


WIDEST_CRACK = 1e-3
"""Corners at most so far apart along each axis may be one [m]: the sides of a box about those that should be."""

_WIDTHS = 1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 1e-1, 0.17, 0.3, 0.55, 1.0
"""Shares of the widest crack, tried in turn: the least that closes all is used, lest small triangles collapse."""


def seams(
    vertices: Floats, triangles: Integers, widest: float = WIDEST_CRACK, numbered: tuple[Integers, int] | None = None
) -> tuple[Integers, float]:
    """Find the vertex that each vertex should be, so that no edge is left that is one triangle's only.

    Args:
        vertices: Shape (v, 3) [m], no two at one place.
        triangles: Shape (t, 3), each with three different vertices.
        widest: Largest distance along each axis of corners that should be one [m].
        numbered: The result of `numbered_edges`, if it is at hand.

    Returns:
        Vertices, shape (v,), and the width of the widest crack [m], the diagonal of the box about its corners. Without
        such an edge, or where joining leaves some, each vertex stays itself and the width is 0.
    """
    alone = np.arange(len(vertices))
    loose = _loose(triangles, numbered or numbered_edges(triangles))
    if not len(loose) or widest <= 0.0:
        return alone, 0.0
    open_ = np.zeros(len(vertices), bool)
    open_[loose] = True
    near = triangles[open_[triangles].any(axis=1)]  # joining changes no edge but those of these
    for width in widest * np.array(_WIDTHS):
        joined, widths = alone.copy(), np.zeros(1)
        joined[loose], widths = _join_points(vertices[loose], loose, float(width))
        welded = joined[near]
        welded = welded[are_proper(welded)]
        if not len(_loose(welded, numbered_edges(welded), open_)):
            return joined, float(widths.max())
    return alone, 0.0


def crack_lids(triangles: Integers, joined: Integers) -> Integers:
    """Make lids (n, 3) between edges of triangles (t, 3) and the edges that they should be by `seams` (v,).

    No triangle is moved; a lid reaches no further from an edge than the crack is wide. Where the joined surface is
    closed, so is this one with its lids.
    """
    start, end = boundary(triangles).T
    lids = np.concatenate(
        [np.column_stack([end, start, joined[start]]), np.column_stack([end, joined[start], joined[end]])]
    )
    kept: Integers = lids[are_proper(lids)]
    return kept


def are_proper(triangles: Integers) -> np.ndarray:
    """Which triangles (t, 3) have three different vertices, shape (t,)."""
    a, b, c = triangles.T
    proper: np.ndarray = (a != b) & (b != c) & (c != a)
    return proper


def _loose(triangles: Integers, numbered: tuple[Integers, int], among: np.ndarray | None = None) -> Integers:
    """Return the vertices of edges of one triangle only, ascending; of edges with a given vertex (v,), bool."""
    numbers, edges = numbered
    alone = np.bincount(numbers, minlength=edges) == 1
    if not alone.any():
        return np.empty(0, np.int64)
    sides = np.flatnonzero(alone[numbers])
    start, end = triangles.ravel()[sides], triangles[sides // 3, (sides + 1) % 3]
    if among is not None:
        counted = among[start] | among[end]
        start, end = start[counted], end[counted]
    return np.unique(np.concatenate([start, end]))


def _join_points(points: Floats, indices: Integers, width: float) -> tuple[Integers, Floats]:
    """Find for each point the first of those it should be one with, itself if their box exceeds the width.

    Points that are at most `width` apart share a cell of twice the width in one of eight grids.
    """
    near = []
    for shift in itertools.product((0.0, 0.5), repeat=3):
        cells = np.floor(points / (2.0 * width) + shift)
        order = np.lexsort(cells.T)
        same = (cells[order][1:] == cells[order][:-1]).all(axis=1)
        near.append(np.column_stack([order[:-1], order[1:]])[same])
    labels = find_connected(len(points), np.concatenate(near))
    low, high = np.full((len(points), 3), np.inf), np.full((len(points), 3), -np.inf)
    np.minimum.at(low, labels, points)
    np.maximum.at(high, labels, points)
    sides = high[labels] - low[labels]
    fit = (sides <= width).all(axis=1)
    return np.where(fit, indices[labels], indices), np.where(fit, np.linalg.norm(sides, axis=1), 0.0)
