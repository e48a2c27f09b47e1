"""Depths of points in a body, largest balls in it, cells of it that no ball covers, and bounds on distances to it.

A body is the union of solids, each bounded by a closed surface; they may overlap. All surfaces are trees in the same
tables (`SurfaceTables`), a row of `spans` says where each is. Covers and decompositions rely on bounds that hold
whatever rounding does: `ROUNDING` may grow, not shrink. `STEPS`, `TOUCHING`, `FINENESS` and `FINEST` change which balls
and cells are found, and with them the covers of robots, not whether these contain the body: depths are found anew.
"""

from __future__ import annotations

import math

import numpy as np

from guidefield.kernels.distance.triangle_distance import (
    Span,
    SurfaceTables,
    nearest_of,
    nearest_triangle,
    surface_distance,
)
from guidefield.kernels.distance.winding import ray_winding
from guidefield.kernels.jit.arrays import Floats, IndexRows, Indices, Integers, RowOut, Rows, RowsOut
from guidefield.kernels.jit.decorators import inlined, kernel

STEPS = 40  # of shrinking a tangent ball, at most: it may be too large after them
ROUNDING = 1e-9  # widening of bounds that come from a neighbouring point's distance, as a share and in metres
TOUCHING = 5e-3  # share of its radius by which a ball may reach beyond the surface while it is shrunk


@inlined
def span_of(spans: np.ndarray, k: int) -> Span:
    """Row k of `spans`, shape (surfaces, 4), as a tuple."""
    return spans[k, 0], spans[k, 1], spans[k, 2], spans[k, 3]


@inlined
def no_further(distance: float, x: float, y: float, z: float) -> float:
    """Bound the distance at a point by that at another one, which is (x, y, z) away, whatever rounding does [m]."""
    return (distance + math.sqrt(x * x + y * y + z * z)) * (1.0 + ROUNDING) + ROUNDING


@inlined
def gap_to(x: float, y: float, z: float, surfaces: SurfaceTables, spans: np.ndarray, bound: float) -> float:
    """Return distance of a point to the nearest of surfaces, whose trees `spans` (k, 4) has; less than `bound` [m]."""
    nearest = math.inf
    for k in range(spans.shape[0]):
        cutoff = min(nearest, bound)
        nearest = min(nearest, surface_distance(x, y, z, surfaces, span_of(spans, k), False, cutoff)[0])
    if nearest == math.inf and bound < math.inf:  # so far away that rounding is larger than what was allowed for it
        for k in range(spans.shape[0]):
            nearest = min(nearest, surface_distance(x, y, z, surfaces, span_of(spans, k), False, nearest)[0])
    return nearest


@inlined
def is_inside(x: float, y: float, z: float, surfaces: SurfaceTables, spans: np.ndarray) -> bool:
    """Tell if a point is in any of the solids; arguments as in `gap_to`, `spans` of shape (k, 4)."""
    for k in range(spans.shape[0]):  # noqa: SIM110 - numba has no generators here
        if ray_winding(x, y, z, surfaces, span_of(spans, k)) != 0:
            return True
    return False


@inlined
def in_ball(x: float, y: float, z: float, balls: Floats, i: int) -> bool:
    """Tell if a point is for certain within ball i, rows of centre and radius, shape (n, 4) at least [m].

    If no surface enters the ball, the point is on the side where the centre is.
    """
    dx, dy, dz, radius = x - balls[i, 0], y - balls[i, 1], z - balls[i, 2], balls[i, 3] * (1.0 - ROUNDING) - ROUNDING
    within: bool = radius > 0.0 and dx * dx + dy * dy + dz * dz < radius * radius
    return within


@kernel
def depths_at(points: Rows, surfaces: SurfaceTables, spans: IndexRows, depths_out: RowOut) -> None:
    """Write the least depth of each of `points` (n, 3) in a body, (n,) [m]: the radius of a ball in one solid.

    Outside it is less than zero by the distance to the body; `spans` (k, 4) are the trees of the closed surfaces.
    """
    count = spans.shape[0]
    # where the last point inside of each solid was, and its depth; the same of the last one outside of all
    last = np.zeros((count + 1, 4))
    last[:, 3] = math.inf
    for i in range(points.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        depth, bound, outside = -math.inf, math.inf, False
        for k in range(count + 1):
            bound = min(bound, no_further(last[k, 3], x - last[k, 0], y - last[k, 1], z - last[k, 2]))
        if last[count, 3] < math.inf:
            outside = in_ball(x, y, z, last, count)
        for k in range(0 if outside else count):
            span = span_of(spans, k)
            if (last[k, 3] < math.inf and in_ball(x, y, z, last, k)) or ray_winding(x, y, z, surfaces, span) != 0:
                reach = no_further(last[k, 3], x - last[k, 0], y - last[k, 1], z - last[k, 2])
                own = gap_to(x, y, z, surfaces, spans[k : k + 1], reach)
                last[k, 0], last[k, 1], last[k, 2], last[k, 3] = x, y, z, own
                depth = max(depth, own)
        if depth < 0.0:
            depth = -gap_to(x, y, z, surfaces, spans, bound)
            last[count, 0], last[count, 1], last[count, 2], last[count, 3] = x, y, z, -depth
        depths_out[i] = depth


@kernel
def distances_at(points: Rows, surfaces: SurfaceTables, spans: IndexRows, distances_out: RowOut) -> None:
    """Write distances of `points` (n, 3) to surfaces with trees `spans` (k, 4), closed or not, shape (n,) [m]."""
    bound = math.inf
    for i in range(points.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        if i > 0:
            bound = no_further(distances_out[i - 1], x - points[i - 1, 0], y - points[i - 1, 1], z - points[i - 1, 2])
        distances_out[i] = gap_to(x, y, z, surfaces, spans, bound)


@kernel
def tangent_balls(
    points: Rows,
    inward: Rows,
    solids: Indices,
    surfaces: SurfaceTables,
    spans: IndexRows,
    largest: float,
    slack: float,
    centres_out: RowsOut,
) -> None:
    """Write the centres (n, 3) of the largest balls in a solid that all but touch its surface at points (n, 3) [m].

    A ball about p + s u, p the point and u inward (n, 3), of radius s - slack, that starts too large, s = `largest`, is
    shrunk: the point q of the surface that is nearest to its centre is on the one with s = (|w|^2 - slack^2) / (2 (u.w
    - slack)), w = q - p. The slack lets a ball grow past the facets next to its own, which would stop it early.
    `solids` (n,) names the solid of each point, `spans` (k, 4) their trees.

    Source, without slack: J. Ma, S. W. Bae and S. Choi, "3D medial axis point approximation using nearest neighbors and
    the normal field", The Visual Computer 28, 2012.
    """
    for i in range(points.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        ux, uy, uz = inward[i, 0], inward[i, 1], inward[i, 2]
        span = span_of(spans, solids[i])
        s = largest
        for _ in range(STEPS):
            cx, cy, cz = x + s * ux, y + s * uy, z + s * uz
            d, nx, ny, nz = surface_distance(cx, cy, cz, surfaces, span, False, (1.0 - TOUCHING) * (s - slack))
            if d == np.inf:
                break
            wx, wy, wz = cx - d * nx - x, cy - d * ny - y, cz - d * nz - z
            along = wx * ux + wy * uy + wz * uz - slack
            square = wx * wx + wy * wy + wz * wz - slack * slack
            if along <= 0.0 or square >= 2.0 * along * s:
                break
            s = square / (2.0 * along)
        centres_out[i, 0] = x + s * ux
        centres_out[i, 1] = y + s * uy
        centres_out[i, 2] = z + s * uz


FINENESS = 0.1
"""A cell within the body that is in no single ball is returned when its half size is this share of its depth."""

FINEST = 0.25  # the same next to the surface, as a share of the margin; with both 0 cells outgrow `_STACK`

_STACK = 8 * 64  # cells that wait: seven more for each of at most 64 halvings
_DIAGONAL = math.sqrt(3.0)


@inlined
def _in_ball(x: float, y: float, z: float, half: float, balls: Floats, i: int) -> bool:
    """Tell if ball i contains the cube of half size `half` about a point."""
    dx, dy, dz = abs(x - balls[i, 0]) + half, abs(y - balls[i, 1]) + half, abs(z - balls[i, 2]) + half
    inside: bool = dx * dx + dy * dy + dz * dz <= balls[i, 3] * balls[i, 3]
    return inside


@inlined
def _halve(cell: Floats, inside: float, waiting: Floats, top: int) -> int:
    half = 0.5 * cell[3]
    for k in range(8):
        waiting[top, 0] = cell[0] + (half if k & 1 else -half)
        waiting[top, 1] = cell[1] + (half if k & 2 else -half)
        waiting[top, 2] = cell[2] + (half if k & 4 else -half)
        waiting[top, 3] = half
        waiting[top, 4] = inside
        top += 1
    return top


@kernel
def uncovered_cells(
    balls: Rows, box: Rows, margin: float, surfaces: SurfaceTables, spans: IndexRows, cells_out: RowsOut
) -> int:
    """Write cells of a body's inside not known to be in the balls (n, 4), while there is room; return their number.

    A cell is done with if it is in one ball, or wholly outside, or so close to the surface that it is within the
    `margin` [m] by which the balls contain the surface: every point of the body is in a cell that is done with or
    returned. `box` (1, 4) is centre and half size of a cube about the body, `spans` (k, 4) are the trees of its solids;
    `cells_out` (m, 5) gets centre, half size and depth [m].
    """
    waiting = np.zeros((_STACK, 5))
    waiting[0, :4] = box[0]
    top, count, last = 1, 0, 0
    cell, before = np.zeros(5), np.array([0.0, 0.0, 0.0, math.inf])  # before: the last cell's centre and depth
    while top > 0 and count < cells_out.shape[0]:
        top -= 1
        cell[:] = waiting[top]
        x, y, z, half, inside = cell[0], cell[1], cell[2], cell[3], cell[4]
        if _in_ball(x, y, z, half, balls, last):
            continue
        found = -1
        for i in range(balls.shape[0]):
            if _in_ball(x, y, z, half, balls, i):
                found = i
                break
        if found >= 0:
            last = found
            continue
        bound = no_further(before[3], x - before[0], y - before[1], z - before[2])
        depth = gap_to(x, y, z, surfaces, spans, bound)
        before[0], before[1], before[2], before[3] = x, y, z, depth
        corner = _DIAGONAL * half
        if depth + corner <= margin:
            continue
        if depth > corner:
            # no surface in the cell: it is inside or outside as a whole
            if inside == 0.0 and not is_inside(x, y, z, surfaces, spans):
                continue
            inside = 1.0
            if half <= max(FINENESS * depth, FINEST * margin):
                cells_out[count, :4] = cell[:4]
                cells_out[count, 4] = depth
                count += 1
                continue
        top = _halve(cell, inside, waiting, top)
    return count


_NODE = 15
"""Numbers of a triangle that waits: its corners, the bound for its points, its centroid's distance, the centroid [m],
and the triangle of the surface that is nearest to that."""


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
                square, nearest = nearest_of((x, y, z), surfaces.corners, found, found + 1, math.inf, found)
                distance = math.sqrt(square)
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
    the solid; and the distance to one triangle of the surface, which is convex, is largest at a corner. Insides are
    only asked for where the bound is above what is `settled`. Rows of `before`: the last centroid and its distance, the
    last one that was asked about with the answer.
    """
    x, y, z = (t[0] + t[3] + t[6]) / 3.0, (t[1] + t[4] + t[7]) / 3.0, (t[2] + t[5] + t[8]) / 3.0
    bound = no_further(before[0, 3], x - before[0, 0], y - before[0, 1], z - before[0, 2])
    distance, nearest = _nearest(x, y, z, surfaces, spans, bound)
    before[0, 0], before[0, 1], before[0, 2], before[0, 3] = x, y, z, distance
    radius = farthest = 0.0
    for k in range(0, 9, 3):
        dx, dy, dz = t[k] - x, t[k + 1] - y, t[k + 2] - z
        radius = max(radius, dx * dx + dy * dy + dz * dz)
        at = (t[k], t[k + 1], t[k + 2])
        farthest = max(farthest, nearest_of(at, surfaces.corners, nearest, nearest + 1, math.inf, nearest)[0])
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
    k = count
    while k > 0 and nodes[heap[(k - 1) // 2], 9] < nodes[node, 9]:
        heap[k] = heap[(k - 1) // 2]
        k = (k - 1) // 2
    heap[k] = node


@inlined
def _pop(heap: Integers, nodes: Floats, count: int) -> None:
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


@kernel
def largest_distance(
    triangles: Rows,
    surfaces: SurfaceTables,
    spans: IndexRows,
    solid: bool,
    tolerance: float,
    share: float,
    enough: float,
) -> float:
    """Bound the distance from points of triangles (n, 9) to a surface or a body, little too large [m].

    It is too large by at most `tolerance` [m], positive, or by `share` of the distance; if it is above `enough` [m] the
    largest distance may be any that is. `spans` (k, 4) says where the trees of the surface stand; of a `solid` all that
    is inside is at no distance.
    """
    known = settled = 0.0
    slack = tolerance
    nodes, heap = np.empty((triangles.shape[0] + 64, _NODE)), np.empty(triangles.shape[0] + 64, np.int64)
    before, heights = np.zeros((2, 5)), np.empty(3)
    before[0, 3] = math.inf
    waiting = used = given = 0  # triangles in the heap, rows of `nodes` in use, those given that were bounded
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
