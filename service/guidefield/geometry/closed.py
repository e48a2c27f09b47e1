"""Closed surfaces of triangles: vertices merged, gaps and cracks closed, pieces told apart, crossing faces found.

No vertex moves: lids are added, so what a closed mesh contains is as it was given. Whether a mesh counts as closed, for
collisions and for proofs alike, depends on `WIDEST_CRACK`, `_WIDTHS` and the exact comparison of places.

A piece of a link counts as hidden inside another only if none cross (`solid.find_nested`), and users are warned of
crossings (`mesh_surface.py`). Beyond `SWEPT` or `EXAMINED` pairs the answer is incomplete, and says so: slabs, chunks
and the sample decide how soon, and what is found till then.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from guidefield.geometry.surfaces import Floats, Integers, extents
from guidefield.kernels.cover.mesh_cleaning import lowest_connected, merge_points, swept_pairs, write_planes
from guidefield.kernels.distance.triangle_rows import count_ways, number_edges, triangle_boxes
from guidefield.kernels.distance.winding import signed_volume


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
"""Corners at most so far apart along each axis may be one [m]: the sides of a box about those that should be.

docs/certificate.md, robots.md and scenes.md state it, and messages/scene.py for the wire.
"""

_WIDTHS = 1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 1e-1, 0.17, 0.3, 0.55, 1.0
"""Shares of the widest crack, ascending to 1: the first that closes all is used, lest small triangles collapse."""


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


_TOUCHING = 1e-10  # faces that reach through each other by less than this fraction of the mesh's size only touch
SWEPT = 60_000_000  # pairs that overlap along one axis, looked at in one mesh at most
EXAMINED = 10_000_000  # pairs whose boxes overlap, looked at in one mesh at most

_CHUNK = 200_000  # pairs that are examined together

_MOST_SLABS, _IN_SLAB = 128, 1000  # slabs at most, and triangles in one at least

_SAMPLE = 20_000  # this many boxes tell along which axis the fewest overlap


@dataclass(frozen=True, eq=False)
class Crossings:
    """Crossing triangles: sorted pairs (n, 2), the lower index first; incomplete beyond `SWEPT` or `EXAMINED`."""

    pairs: Integers
    complete: bool


def crossings(vertices: Floats, triangles: Integers) -> Crossings:
    """Find pairs of triangles (t, 3) of vertices (v, 3), no two at one place, whose insides cross.

    Two cross if each has corners on both sides of the other's plane and the segments in which they meet the planes'
    common line overlap (T. Moeller, A fast triangle-triangle intersection test, 1997). Faces that touch do not: in a
    plane, at an edge, at a corner. Nor do those that another face crosses exactly along an edge.
    """
    if not len(triangles):  # all have been joined to edges and points
        return Crossings(np.empty((0, 2), np.int64), True)
    centred, triangles = vertices - vertices.mean(axis=0), np.ascontiguousarray(triangles, np.int64)
    boxes = np.empty((len(triangles), 6))
    triangle_boxes(centred, triangles, boxes)
    size = float(np.linalg.norm(extents(vertices)))
    tolerance = _TOUCHING * size + 32.0 * np.finfo(float).eps * float(np.abs(vertices).max())
    found, examined, complete = [np.empty((0, 2), np.int64)], 0, True
    corners, planes = np.empty((len(triangles), 9)), np.empty((len(triangles), 5))
    write_planes(centred, triangles, tolerance, corners, planes)
    waiting, count = list[Integers](), 0
    for overlapping, pairs in _overlapping(boxes, corners, planes):
        examined += overlapping
        if pairs is None or examined > EXAMINED:
            complete = False
            break
        waiting.append(pairs)
        count += len(pairs)
        if count > _CHUNK:
            found.append(_crossing(centred, triangles, waiting, tolerance))
            waiting, count = [], 0
    found.append(_crossing(centred, triangles, waiting, tolerance))
    listed = np.sort(np.concatenate(found), axis=1)
    return Crossings(listed[np.lexsort((listed[:, 1], listed[:, 0]))], complete)


def _overlapping(boxes: Floats, corners: Floats, planes: Floats) -> Iterator[tuple[int, Integers | None]]:
    """How many pairs of boxes (n, 6) overlap, and pairs (m, 2) that may cross, some at a time; None where too many.

    It is swept along the axis that separates most, slab by slab across the next one.
    """
    low, high = boxes[:, :3], boxes[:, 3:]
    few = slice(None, None, max(1, len(low) // _SAMPLE))
    axis, across = np.argsort([_count_overlaps(low[few, axis], high[few, axis]) for axis in range(3)], kind="stable")[
        :2
    ].tolist()
    slabs, order, ends = _sort_for_sweep(low[:, axis], high[:, axis], low[:, across], high[:, across])
    others = [other for other in range(3) if other != axis]
    low, high = (np.ascontiguousarray(corner[order][:, others].T) for corner in (low, high))
    before = np.concatenate([[0], np.cumsum(np.maximum(ends - np.arange(len(order)) - 1, 0))])
    start, sizes = 0, np.zeros(2, np.int64)
    while start < len(order):
        stop = max(start + 1, int(np.searchsorted(before, before[start] + _CHUNK, side="right")) - 1)
        if before[stop] > SWEPT:
            yield 0, None
            return
        pairs = np.empty((int(before[stop] - before[start]), 2), np.int64)
        swept_pairs(low, high, ends, slabs, order, corners, planes, start, stop, pairs, sizes)
        yield int(sizes[0]), pairs[: sizes[1]]
        start = stop


def _count_overlaps(low: Floats, high: Floats) -> int:
    """With how many that begin at or before its end each of some intervals (n,) is in order, all together."""
    return int(np.searchsorted(np.sort(low), high, side="right").sum())


def _sort_for_sweep(
    low: Floats, high: Floats, low_across: Floats, high_across: Floats
) -> tuple[Integers, Integers, Integers]:
    """Rows for a sweep of intervals (n,), those in each slab across it together, by their lower ends.

    Returns:
        The slab of each row and the first one of its interval, shape (m, 2), the interval of each row, and behind the
        last row of the slab that begins within it, shape (m,).
    """
    begin, count = low_across.min(), max(1, min(_MOST_SLABS, len(low) // _IN_SLAB))
    width = max((high_across.max() - begin) / count, 1e-300)
    first, last = (np.minimum(((at - begin) / width).astype(np.int64), count - 1) for at in (low_across, high_across))
    spans = last - first + 1
    order = np.repeat(np.arange(len(low)), spans)
    slab = np.arange(len(order)) - np.repeat(np.cumsum(spans) - spans - first, spans)
    reach = 2.0 * (high.max() - low.min()) + 1.0
    keys = slab * reach + (low[order] - low.min())
    sorted_rows = np.argsort(keys, kind="stable")
    order, slab, keys = order[sorted_rows], slab[sorted_rows], keys[sorted_rows]
    ends = np.searchsorted(keys, slab * reach + (high[order] - low.min()), side="right")
    return np.column_stack([slab, first[order]]), order, ends


def _crossing(vertices: Floats, triangles: Integers, some: list[Integers], tolerance: float) -> Integers:
    """Those of some pairs (n, 2) that cross."""
    pairs = np.concatenate([np.empty((0, 2), np.int64), *some])
    return pairs[_cross(vertices, triangles, pairs, tolerance)] if len(pairs) else pairs


def _cross(vertices: Floats, triangles: Integers, pairs: Integers, tolerance: float) -> np.ndarray:
    first, second = triangles[pairs[:, 0]], triangles[pairs[:, 1]]
    one, other = vertices[first], vertices[second]
    shared = first[:, :, None] == second[:, None, :]
    normal_one, blur_one = _normals(one)
    normal_other, blur_other = _normals(other)
    heights_one = _heights(one, other, normal_other, tolerance + blur_other, shared.any(axis=2))
    heights_other = _heights(other, one, normal_one, tolerance + blur_one, shared.any(axis=1))
    crossing: np.ndarray = _straddles(heights_one) & _straddles(heights_other)
    kept = np.flatnonzero(crossing)
    line = np.cross(normal_one[kept], normal_other[kept])
    line /= np.maximum(np.linalg.norm(line, axis=1, keepdims=True), 1e-300)
    origin = one[kept, :1]
    low, high = _segment(np.einsum("nij,nj->ni", one[kept] - origin, line), heights_one[kept])
    low_other, high_other = _segment(np.einsum("nij,nj->ni", other[kept] - origin, line), heights_other[kept])
    crossing[kept] = np.minimum(high, high_other) - np.maximum(low, low_other) > tolerance
    return crossing


def _normals(corners: Floats) -> tuple[Floats, Floats]:
    """Unit normals (n, 3), zero for faces without area; how far rounding lifts a height over a sliver's plane [m]."""
    sides = np.roll(corners, -1, axis=1) - corners
    normals = np.cross(sides[:, 0], sides[:, 1])
    length = np.linalg.norm(normals, axis=1)
    longest = np.linalg.norm(sides, axis=2).max(axis=1)
    flat = length <= 1e-14 * longest**2
    safe = np.where(flat, 1.0, length)
    normals = np.where(flat[:, None], 0.0, normals / safe[:, None])
    return normals, 8.0 * np.finfo(float).eps * longest**3 / safe


def _heights(corners: Floats, base: Floats, normals: Floats, tolerance: Floats, shared: np.ndarray) -> Floats:
    """Heights (n, 3) of corners over the plane of the base; 0 where they only touch it [m]."""
    heights = np.einsum("nij,nj->ni", corners - base[:, :1], normals)
    return np.where(shared | (np.abs(heights) <= tolerance[:, None]), 0.0, heights)


def _straddles(heights: Floats) -> np.ndarray:
    above, below = heights.max(axis=1) > 0.0, heights.min(axis=1) < 0.0
    both: np.ndarray = np.logical_and(above, below)
    return both


def _segment(along: Floats, heights: Floats) -> tuple[Floats, Floats]:
    """Ends on the common line of triangles given by places along it and heights beside it, each shape (n, 3)."""
    next_along, next_heights = np.roll(along, -1, axis=1), np.roll(heights, -1, axis=1)
    cut = heights * next_heights < 0.0
    share = np.where(cut, heights / np.where(cut, heights - next_heights, 1.0), 0.0)
    places = np.concatenate([along + share * (next_along - along), along], axis=1)
    there = np.concatenate([cut, heights == 0.0], axis=1)
    return np.where(there, places, np.inf).min(axis=1), np.where(there, places, -np.inf).max(axis=1)
