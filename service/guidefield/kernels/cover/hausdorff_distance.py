"""The one-sided Hausdorff distance from triangles to a surface or a solid, between two bounds.

Branch and bound, the triangle that may stand off furthest first: no triangle is divided that needn't be, and one that
stands off far is found soon. Source: M. Tang, M. Lee and Y. J. Kim, "Interactive Hausdorff distance computation for
general polygonal models", ACM Transactions on Graphics 28(3), 2009. A triangle that lies on the surface is divided
along the edges of the surface's triangles, so that the parts lie on one triangle each; others are quartered.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types

from guidefield.kernels.cover.inscribed import SPANS, in_ball, is_inside, no_further, span_of
from guidefield.kernels.distance.triangle_distance import SURFACES, SurfaceTables, nearest_triangle
from guidefield.kernels.jit.signatures import MATRIX, SCALAR, Floats, Integers, compiled, inlined

_NODE = 15
"""Numbers of a triangle that waits: its corners, the bound for its points, its centroid's distance, the centroid [m],
and the triangle of the surface that is nearest to that."""


@inlined
def _to_edge(ax: float, ay: float, az: float, ux: float, uy: float, uz: float) -> float:
    """Square of the distance of a point `a` from the segment from the origin to u."""
    share = min(max((ax * ux + ay * uy + az * uz) / (ux * ux + uy * uy + uz * uz), 0.0), 1.0)
    dx, dy, dz = ax - share * ux, ay - share * uy, az - share * uz
    return dx * dx + dy * dy + dz * dz


@inlined
def _to_triangle(x: float, y: float, z: float, corners: Floats, i: int) -> float:
    """Square of the distance of a point from triangle i, rows of corner a and edges b - a, c - a."""
    ax, ay, az = x - corners[i, 0], y - corners[i, 1], z - corners[i, 2]
    ux, uy, uz = corners[i, 3], corners[i, 4], corners[i, 5]
    vx, vy, vz = corners[i, 6], corners[i, 7], corners[i, 8]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    square = nx * nx + ny * ny + nz * nz
    # shares of b and c in the foot of the point on the plane
    b = ((ay * vz - az * vy) * nx + (az * vx - ax * vz) * ny + (ax * vy - ay * vx) * nz) / square
    c = ((uy * az - uz * ay) * nx + (uz * ax - ux * az) * ny + (ux * ay - uy * ax) * nz) / square
    if b >= 0.0 and c >= 0.0 and b + c <= 1.0:
        height = ax * nx + ay * ny + az * nz
        above: float = height * height / square
        return above
    return min(
        _to_edge(ax, ay, az, ux, uy, uz),
        _to_edge(ax, ay, az, vx, vy, vz),
        _to_edge(ax - ux, ay - uy, az - uz, vx - ux, vy - uy, vz - uz),
    )


@inlined
def _nearest(
    x: float, y: float, z: float, surfaces: SurfaceTables, spans: np.ndarray, bound: float
) -> tuple[float, int]:
    """Distance of a point to all surfaces [m], which is less than a bound, and the triangle that is nearest."""
    distance, nearest = bound, -1
    while nearest < 0:
        for k in range(spans.shape[0]):
            found = nearest_triangle(x, y, z, surfaces, span_of(spans, k), distance)
            if found >= 0:
                distance, nearest = math.sqrt(_to_triangle(x, y, z, surfaces.corners, found)), found
        if distance == math.inf:
            break
        if nearest < 0:  # so far away that rounding is larger than what was allowed for it
            distance = math.inf
    return distance, nearest


@inlined
def _bounds(
    t: Floats, surfaces: SurfaceTables, spans: np.ndarray, solid: bool, settled: float, before: Floats
) -> tuple[float, float, int]:
    """Distance of a triangle's centroid to the surface or solid, a bound for its points [m], the nearest triangle.

    No point is farther than the centroid by more than their distance, and if the centroid is deep inside, none leaves
    the solid. And the distance to one triangle of the surface, which is convex, is largest at a corner. What is inside
    is only asked where the bound is above what is settled. Rows of
    `before` are the last centroid and its distance, and the last one of which was asked, with the answer.
    """
    x, y, z = (t[0] + t[3] + t[6]) / 3.0, (t[1] + t[4] + t[7]) / 3.0, (t[2] + t[5] + t[8]) / 3.0
    bound = no_further(before[0, 3], x - before[0, 0], y - before[0, 1], z - before[0, 2])
    distance, nearest = _nearest(x, y, z, surfaces, spans, bound)
    before[0, 0], before[0, 1], before[0, 2], before[0, 3] = x, y, z, distance
    radius = farthest = 0.0
    for k in range(0, 9, 3):
        dx, dy, dz = t[k] - x, t[k + 1] - y, t[k + 2] - z
        radius = max(radius, dx * dx + dy * dy + dz * dz)
        farthest = max(farthest, _to_triangle(t[k], t[k + 1], t[k + 2], surfaces.corners, nearest))
    radius, farthest = math.sqrt(radius), math.sqrt(farthest)
    farthest = min(distance + radius, farthest)
    if solid and farthest > settled:
        # no surface is between this point and the last one that was asked about, if that is further from any
        if not in_ball(x, y, z, before, 1):
            before[1, 4] = 1.0 if is_inside(x, y, z, surfaces, spans) else 0.0
        before[1, 0], before[1, 1], before[1, 2], before[1, 3] = x, y, z, distance
        if before[1, 4] > 0.0:
            farthest = min(max(radius - distance, 0.0), farthest)
            distance = 0.0
    return distance, farthest, nearest


@inlined
def _quarter(t: Floats, out: Floats) -> int:
    """Write the four triangles between a triangle's corners and its edges' middles."""
    for a in range(3):
        x, y, z = t[a], t[3 + a], t[6 + a]
        xy, yz, zx = 0.5 * (x + y), 0.5 * (y + z), 0.5 * (z + x)
        out[0, a], out[0, 3 + a], out[0, 6 + a] = x, xy, zx
        out[1, a], out[1, 3 + a], out[1, 6 + a] = xy, y, yz
        out[2, a], out[2, 3 + a], out[2, 6 + a] = zx, yz, z
        out[3, a], out[3, 3 + a], out[3, 6 + a] = xy, yz, zx
    return 4


@inlined
def _across_edge(t: Floats, corners: Floats, i: int, edge: int, heights: Floats) -> float:
    """Write heights of corners over the plane that stands on an edge of triangle i; the less of both sides [m]."""
    ux, uy, uz = corners[i, 3], corners[i, 4], corners[i, 5]
    vx, vy, vz = corners[i, 6], corners[i, 7], corners[i, 8]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    ax, ay, az = corners[i, 0], corners[i, 1], corners[i, 2]
    if edge == 0:
        ex, ey, ez = ux, uy, uz
    elif edge == 1:
        ex, ey, ez = vx, vy, vz
    else:
        ex, ey, ez = vx - ux, vy - uy, vz - uz
        ax, ay, az = ax + ux, ay + uy, az + uz
    cx, cy, cz = ey * nz - ez * ny, ez * nx - ex * nz, ex * ny - ey * nx
    length = math.sqrt(cx * cx + cy * cy + cz * cz)
    low = high = 0.0
    for k in range(3):
        x, y, z = t[3 * k] - ax, t[3 * k + 1] - ay, t[3 * k + 2] - az
        heights[k] = (x * cx + y * cy + z * cz) / length
        low, high = min(low, heights[k]), max(high, heights[k])
    less: float = min(-low, high)
    return less


@inlined
def _split(t: Floats, heights: Floats, out: Floats) -> int:
    """Write the three triangles that a plane divides one into, some of whose corners are above it and some below."""
    alone = 0
    for k in range(3):
        if (heights[k] > 0.0) != (heights[(k + 1) % 3] > 0.0) and (heights[k] > 0.0) != (heights[(k + 2) % 3] > 0.0):
            alone = k
    second, third = (alone + 1) % 3, (alone + 2) % 3
    to_second = heights[alone] / (heights[alone] - heights[second])
    to_third = heights[alone] / (heights[alone] - heights[third])
    for a in range(3):
        x, y, z = t[3 * alone + a], t[3 * second + a], t[3 * third + a]
        xy, xz = x + to_second * (y - x), x + to_third * (z - x)
        out[0, a], out[0, 3 + a], out[0, 6 + a] = x, xy, xz
        out[1, a], out[1, 3 + a], out[1, 6 + a] = xy, y, z
        out[2, a], out[2, 3 + a], out[2, 6 + a] = xy, z, xz
    return 3


@inlined
def _divide(t: Floats, corners: Floats, on_surface: bool, tolerance: float, heights: Floats, out: Floats) -> int:
    """Write the triangles that one that waits is divided into; how many."""
    if on_surface:
        nearest, best, edge = int(t[14]), tolerance, -1
        for k in range(3):
            less = _across_edge(t, corners, nearest, k, heights)
            if less > best:
                best, edge = less, k
        if edge >= 0:
            _across_edge(t, corners, nearest, edge, heights)
            return _split(t, heights, out)
    return _quarter(t, out)


@inlined
def _push(heap: Integers, nodes: Floats, count: int, node: int) -> None:
    """Add a triangle to a heap of `count` ones, the largest bound on top."""
    k = count
    while k > 0 and nodes[heap[(k - 1) // 2], 9] < nodes[node, 9]:
        heap[k] = heap[(k - 1) // 2]
        k = (k - 1) // 2
    heap[k] = node


@inlined
def _pop(heap: Integers, nodes: Floats, count: int) -> None:
    """Take the top off a heap of `count` triangles."""
    last, k = heap[count - 1], 0
    while True:
        child = 2 * k + 1
        if child >= count - 1:
            break
        if child + 1 < count - 1 and nodes[heap[child + 1], 9] > nodes[heap[child], 9]:
            child += 1
        if nodes[heap[child], 9] <= nodes[last, 9]:
            break
        heap[k] = heap[child]
        k = child
    heap[k] = last


@compiled(SCALAR(MATRIX, SURFACES, SPANS, types.boolean, SCALAR, SCALAR, SCALAR))
def largest_distance(
    triangles: Floats,
    surfaces: SurfaceTables,
    spans: np.ndarray,
    solid: bool,
    tolerance: float,
    share: float,
    enough: float,
) -> float:
    """Upper bound of the distance from points of triangles to a surface or a body, little too large.

    Args:
        triangles: Corners, nine numbers each, shape (n, 9) [m].
        surfaces: All surfaces.
        spans: Where the trees of the surface stand, shape (k, 4).
        solid: Whether they are solids, so that what is inside one is at no distance.
        tolerance: How much too large the result may be [m], positive.
        share: How much too large it may be as a share of the distance; the larger of the two counts.
        enough: A distance beyond which it doesn't matter how large it is [m].

    Returns:
        The bound [m]; if it is above `enough`, only that the largest distance may be above `enough` too.
    """
    known = settled = 0.0
    slack = tolerance
    nodes, heap = np.empty((triangles.shape[0] + 64, _NODE)), np.empty(triangles.shape[0] + 64, np.int64)
    before, heights = np.zeros((2, 5)), np.empty(3)
    before[0, 3] = math.inf
    waiting = used = given = 0  # triangles in the heap, rows of `nodes` in use, those given that were looked at
    parent, parts = np.empty(_NODE), np.empty((4, 9))
    while True:
        if given < triangles.shape[0]:
            parts[0] = triangles[given]
            given += 1
            count = 1
        else:
            if waiting == 0 or nodes[heap[0], 9] <= known + slack:
                return max(known, settled, nodes[heap[0], 9] if waiting else 0.0)
            parent[:] = nodes[heap[0]]
            _pop(heap, nodes, waiting)
            waiting -= 1
            count = _divide(parent, surfaces.corners, parent[10] <= known + slack, slack, heights, parts)
            before[0, 0], before[0, 1], before[0, 2], before[0, 3] = parent[11], parent[12], parent[13], parent[10]
        for part in range(count):
            distance, farthest, nearest = _bounds(parts[part], surfaces, spans, solid, known + slack, before)
            known = max(known, distance if farthest > known + slack or not solid else 0.0)
            slack = max(tolerance, share * known)
            if known > enough:
                return known
            if farthest <= known + slack:
                settled = max(settled, farthest)
                continue
            if used == nodes.shape[0]:
                more_nodes, more_heap = np.empty((2 * used, _NODE)), np.empty(2 * used, np.int64)
                more_nodes[:used], more_heap[:used] = nodes, heap
                nodes, heap = more_nodes, more_heap
            node = nodes[used]
            node[:9], node[9], node[10] = parts[part], farthest, before[0, 3]
            node[11], node[12], node[13], node[14] = before[0, 0], before[0, 1], before[0, 2], nearest
            _push(heap, nodes, waiting, used)
            waiting += 1
            used += 1
