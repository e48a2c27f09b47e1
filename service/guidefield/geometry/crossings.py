"""Find faces of a mesh that cross each other: pairs by a sweep and by planes, then intervals on the common line.

A piece of a link counts as hidden inside another only if none cross (`solid.find_nested`), and users are warned of
crossings (`mesh_surface.py`). Slabs, chunks and the sample are time alone; beyond `SWEPT` or `EXAMINED` pairs the
answer is incomplete, and says so.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from guidefield.geometry.surfaces import Floats, Integers, extents
from guidefield.kernels.cover.merge_points import swept_pairs, write_planes
from guidefield.kernels.distance.triangle_rows import triangle_boxes

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
