"""Cleaning of meshes: equal points merged, connected components, pairs of triangles that may cross.

Points are merged by an open-addressing hash table over the bits of their coordinates, so that -0.0 differs from 0.0.
`geometry/closed.py` relies on places in order of first occurrence. `_FACTORS` are a matter of speed; with a `_BLUR`
over twice that of its `_normals` crossings are missed, of which users are warned and by which pieces count as hidden.
"""

from __future__ import annotations

import math

import numpy as np
from numba import uint64

from guidefield.kernels.jit.arrays import (
    Floats,
    IndexRows,
    IndexRowsOut,
    Indices,
    IndicesOut,
    Integers,
    Rows,
    RowsOut,
    WordRows,
)
from guidefield.kernels.jit.decorators import inlined, kernel


@inlined
def _may_straddle(corners: Floats, plane: Floats) -> bool:
    """Tell if corners (9,) may be on both sides of a plane: unit normal, distance from the origin, tolerance (5,)."""
    least, most = 0.0, 0.0
    for k in range(3):
        height = corners[3 * k] * plane[0] + corners[3 * k + 1] * plane[1] + corners[3 * k + 2] * plane[2] - plane[3]
        least, most = min(least, height), max(most, height)
    return bool(least < -plane[4] and most > plane[4])


_BLUR = 8.0 * float(np.finfo(float).eps)  # rounding of a height over a plane, times edge^3 over twice the area


@kernel
def write_planes(
    vertices: Rows, triangles: IndexRows, tolerance: float, corners_out: RowsOut, planes_out: RowsOut
) -> None:
    """Write the corners (t, 9) of triangles (t, 3), and their planes.

    A plane is its unit normal, 0 without an area, its distance from the origin, and how far above it at least a corner
    is that is above it: half of a tolerance and of what rounding lifts over a sliver's plane, shape (t, 5) [m].
    """
    for i in range(triangles.shape[0]):
        a, b, c = triangles[i, 0], triangles[i, 1], triangles[i, 2]
        for k in range(3):
            corners_out[i, k] = vertices[a, k]
            corners_out[i, 3 + k] = vertices[b, k]
            corners_out[i, 6 + k] = vertices[c, k]
        row, longest = corners_out[i], 0.0
        ux, uy, uz = row[3] - row[0], row[4] - row[1], row[5] - row[2]
        vx, vy, vz = row[6] - row[0], row[7] - row[1], row[8] - row[2]
        wx, wy, wz = vx - ux, vy - uy, vz - uz
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        length = math.sqrt(nx * nx + ny * ny + nz * nz)
        longest = math.sqrt(max(ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz, wx * wx + wy * wy + wz * wz))
        share = 0.0 if length <= 1e-14 * longest * longest else 1.0 / length
        nx, ny, nz = share * nx, share * ny, share * nz
        planes_out[i, 0], planes_out[i, 1], planes_out[i, 2] = nx, ny, nz
        planes_out[i, 3] = nx * row[0] + ny * row[1] + nz * row[2]
        planes_out[i, 4] = 0.5 * (tolerance + _BLUR * longest * longest * longest * share)


@kernel
def swept_pairs(
    low: Rows,
    high: Rows,
    ends: Indices,
    slabs: IndexRows,
    order: Indices,
    corners: Rows,
    planes: Rows,
    first: int,
    last: int,
    pairs_out: IndexRowsOut,
    counts_out: IndicesOut,
) -> None:
    """Write the pairs (m, 2) of triangles that may cross, of those in rows `first` to `last` - 1 with any later row.

    Their boxes overlap, and each may have corners on both sides of the other's plane.

    Args:
        low: Lower corners of boxes in the two coordinates across the sweep, shape (2, n).
        high: The upper ones.
        ends: Behind the last row that begins within each row's box along the sweep, in the same slab, shape (n,).
        slabs: In which slab a row is, and the first slab of its triangle, which has a row in each, shape (n, 2).
        order: The triangle of each row, shape (n,).
        corners: Of the triangles, and `planes`, as of `write_planes`.
        pairs_out: As many rows as pairs along the sweep.
        counts_out: How many pairs of boxes overlap, and how many are written, shape (2,).
    """
    overlapping = count = 0
    for one in range(first, last):
        for other in range(one + 1, ends[one]):
            if (
                low[0, one] <= high[0, other]
                and low[0, other] <= high[0, one]
                and low[1, one] <= high[1, other]
                and low[1, other] <= high[1, one]
                and max(slabs[one, 1], slabs[other, 1]) == slabs[one, 0]  # of the slabs in which both are the first
            ):
                overlapping += 1
                a, b = order[one], order[other]
                if _may_straddle(corners[a], planes[b]) and _may_straddle(corners[b], planes[a]):
                    pairs_out[count, 0], pairs_out[count, 1] = a, b
                    count += 1
    counts_out[0], counts_out[1] = overlapping, count


@inlined
def _root(labels: Integers, vertex: int) -> int:
    """The lowest vertex that a vertex is known to be connected with: union-find with path halving (R. Tarjan)."""
    while labels[vertex] != vertex:
        labels[vertex] = labels[labels[vertex]]
        vertex = labels[vertex]
    return vertex


@kernel
def lowest_connected(simplices: IndexRows, labels_out: IndicesOut) -> None:
    """Write for each vertex the lowest one that edges or triangles `simplices` (n, k) connect it to, shape (count,)."""
    for vertex in range(labels_out.shape[0]):
        labels_out[vertex] = vertex
    for i in range(simplices.shape[0]):
        a = _root(labels_out, simplices[i, 0])
        for corner in range(1, simplices.shape[1]):
            b = _root(labels_out, simplices[i, corner])
            low, high = min(a, b), max(a, b)
            labels_out[high] = low
            a = low
    for vertex in range(labels_out.shape[0]):  # a label is never above its vertex, so that those before are final
        labels_out[vertex] = labels_out[labels_out[vertex]]


_FACTORS = (0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB)
"""Odd multipliers. Source: S. Vigna, SplitMix64, 2015."""


@inlined
def _hash(words: np.ndarray, i: int) -> int:
    value = words[i, 0] * uint64(_FACTORS[0])
    value = (value ^ (value >> uint64(29))) + words[i, 1]
    value *= uint64(_FACTORS[1])
    value = (value ^ (value >> uint64(32))) + words[i, 2]
    value *= uint64(_FACTORS[2])
    mixed: int = value ^ (value >> uint64(31))
    return mixed


@kernel
def merge_points(words: WordRows, place_out: IndicesOut, first_out: IndicesOut) -> int:
    """Find the distinct ones of points, given by their coordinates' bits (n, 3); return their count.

    Writes each point's place among the distinct ones, and the first point at each place, ascending; shapes (n,).
    """
    size = 16
    while size < 2 * words.shape[0]:
        size *= 2
    slots = np.full(size, -1, np.int64)
    count = 0
    for i in range(words.shape[0]):
        k = np.int64(_hash(words, i) & uint64(size - 1))
        while True:
            known = slots[k]
            if known < 0:
                slots[k] = count
                first_out[count] = i
                place_out[i] = count
                count += 1
                break
            j = first_out[known]
            if words[i, 0] == words[j, 0] and words[i, 1] == words[j, 1] and words[i, 2] == words[j, 2]:
                place_out[i] = known
                break
            k = (k + 1) & (size - 1)
    return count
