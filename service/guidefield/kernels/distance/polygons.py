"""Polygons in the plane: the inradius of a convex one, exact but for rounding, and edges of an outline that touch.

`scene/guide_plane.py` asks for both. Larger insets of a guide plane count as its inradius there, less a share of 1e-9:
one that is too large by more leaves no polygon. An outline whose edges touch is refused.
"""

from __future__ import annotations

import numpy as np

from guidefield.kernels.jit.arrays import Blocks, Floats, IndexRows, IndexRowsOut, Indices, IndicesOut, Row, Rows
from guidefield.kernels.jit.decorators import inlined, inner_kernel, kernel

_PARALLEL = 1e-12  # edges whose normals have a smaller cross product don't meet; with more inradii come out too small
_LATEST = 1e300  # no edge of a bounded polygon vanishes as late


@inlined
def _cross(normals: Floats, a: int, b: int) -> float:
    return float(normals[a, 0] * normals[b, 1] - normals[a, 1] * normals[b, 0])


@inlined
def _edge_length(normals: Floats, offsets: Floats, before: int, k: int, after: int, inset: float) -> float:
    """Length of edge k between two others, all of them moved inwards; negative where these meet beyond."""
    o0, o1, o2 = offsets[before] + inset, offsets[k] + inset, offsets[after] + inset
    t1, t2 = _cross(normals, before, k), _cross(normals, k, after)
    x1 = (o0 * normals[k, 1] - o1 * normals[before, 1]) / t1
    y1 = (normals[before, 0] * o1 - normals[k, 0] * o0) / t1
    x2 = (o1 * normals[after, 1] - o2 * normals[k, 1]) / t2
    y2 = (normals[k, 0] * o2 - normals[after, 0] * o1) / t2
    return float((x2 - x1) * normals[k, 1] - (y2 - y1) * normals[k, 0])


@inlined
def _vanishes(normals: Floats, offsets: Floats, before: int, k: int, after: int) -> float:
    """At which inset edge k between two others vanishes."""
    length = _edge_length(normals, offsets, before, k, after, 0.0)
    inset = length / max(length - _edge_length(normals, offsets, before, k, after, 1.0), 1e-300)
    return inset if inset < _LATEST else _LATEST


@inlined
def _write_leaf(least: Floats, leaf: int, value: float) -> None:
    """Change a leaf of a binary tree whose nodes have the least of their two children, the root first, from 1 on."""
    node = leaf
    least[node] = value
    while node > 1:
        node //= 2
        least[node] = min(least[2 * node], least[2 * node + 1])


@kernel
def inradius(inward: Rows, offsets: Row, straight: float) -> float:
    """Return the largest inset that leaves something over [m]: edges move inwards until all is gone.

    Each edge's length is linear in the inset between two events at which an edge vanishes and is dropped, so each is
    exact. An event changes when the two edges beside it vanish, and a tree has the first of all: k edges take k log k
    steps. `inward` (k, 2) are unit normals, counter-clockwise, and ``inward[i] . x - offsets[i]`` is the height of x
    over edge i [m]; edges whose normals have a cross product below `straight` have no corner of their own.
    """
    edges = inward.shape[0]
    normals, at = np.empty((edges, 2)), np.empty(edges)
    count = 0
    for k in range(edges):
        if _cross(inward, (k - 1) % edges, k) > straight:
            normals[count, 0], normals[count, 1], at[count] = inward[k, 0], inward[k, 1], offsets[k]
            count += 1
    leaves = 1
    while leaves < count:
        leaves *= 2
    before, after, least = np.empty(count, np.int64), np.empty(count, np.int64), np.full(2 * leaves, np.inf)
    for k in range(count):
        before[k], after[k] = (k - 1) % count, (k + 1) % count
        _write_leaf(least, leaves + k, _vanishes(normals, at, before[k], k, after[k]))
    while True:
        node = 1
        while node < leaves:  # of several the first
            node = 2 * node if least[2 * node] == least[node] else 2 * node + 1
        first = node - leaves
        one, other = before[first], after[first]
        if count <= 3 or _cross(normals, one, other) <= _PARALLEL:
            return float(least[1])
        count -= 1
        after[one], before[other] = other, one
        _write_leaf(least, node, np.inf)
        _write_leaf(least, leaves + one, _vanishes(normals, at, before[one], one, after[one]))
        _write_leaf(least, leaves + other, _vanishes(normals, at, before[other], other, after[other]))


@inlined
def _from_segment(x: float, y: float, ax: float, ay: float, bx: float, by: float) -> float:
    along_x, along_y = bx - ax, by - ay
    share = ((x - ax) * along_x + (y - ay) * along_y) / (along_x * along_x + along_y * along_y)
    share = min(max(share, 0.0), 1.0)
    return float(np.hypot(x - (ax + share * along_x), y - (ay + share * along_y)))


@inlined
def _turn(ax: float, ay: float, bx: float, by: float, cx: float, cy: float) -> float:
    """Twice the signed area of the triangle a b c."""
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


@inlined
def _touch(corners: Floats, i: int, j: int, gap: float) -> bool:
    """Tell if edges i and j cross or come that near."""
    count = corners.shape[0]
    ax, ay = corners[i]
    bx, by = corners[(i + 1) % count]
    cx, cy = corners[j]
    dx, dy = corners[(j + 1) % count]
    near = min(_from_segment(cx, cy, ax, ay, bx, by), _from_segment(dx, dy, ax, ay, bx, by))
    near = min(near, _from_segment(ax, ay, cx, cy, dx, dy), _from_segment(bx, by, cx, cy, dx, dy))
    if near <= gap:
        return True
    across = _turn(ax, ay, bx, by, cx, cy) * _turn(ax, ay, bx, by, dx, dy) < 0.0
    return bool(across and _turn(cx, cy, dx, dy, ax, ay) * _turn(cx, cy, dx, dy, bx, by) < 0.0)


@inner_kernel
def touching_edges(corners: Rows, boxes: Rows, order: Indices, gap: float) -> IndicesOut:
    """Return the first two edges that aren't neighbours and cross or come as near as `gap` [m]; twice k where none do.

    Edge i runs from corner i to i + 1 of (k, 2); `boxes` (k, 4) have its least x and y, and its largest, `order` (k,)
    is by least x. A sweep along x: an edge meets only those that begin before it ends. First is the least first edge,
    then the least other.
    """
    count = corners.shape[0]
    found = np.full(2, count)
    for at in range(count):
        one = order[at]
        for later in range(at + 1, count):
            other = order[later]
            if boxes[other, 0] > boxes[one, 2] + 2.0 * gap:
                break
            if boxes[other, 1] > boxes[one, 3] + 2.0 * gap or boxes[one, 1] > boxes[other, 3] + 2.0 * gap:
                continue
            i, j = min(one, other), max(one, other)
            if j - i < 2 or (i == 0 and j == count - 1) or (i, j) > (found[0], found[1]):
                continue
            if _touch(corners, i, j, gap):
                found[0], found[1] = i, j
    return found


@kernel
def touching_edges_of_each(
    corners: Blocks, boxes: Blocks, order: IndexRows, gaps: Row, found_out: IndexRowsOut
) -> None:
    """Write the first touching edges (n, 2) of each of n outlines (n, k, 2), row by row as `touching_edges` does."""
    for i in range(corners.shape[0]):
        found_out[i] = touching_edges(corners[i], boxes[i], order[i], gaps[i])
