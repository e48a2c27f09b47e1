"""How far triangles stand off a surface or a solid: the largest distance of any of their points, between two bounds."""

from __future__ import annotations

import math

import numpy as np
from numba import types

from guidefield.kernels.cover.inscribed import SPANS, in_ball, is_inside, no_further, span_of
from guidefield.kernels.distance.triangle_distance import SURFACES, SurfaceTables, nearest_triangle
from guidefield.kernels.jit.signatures import MATRIX, SCALAR, Floats, compiled, inlined

_STACK = 4 * 64


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
) -> tuple[float, float]:
    """Distance of a triangle's centroid to the surface or solid, and a bound for all of its points [m].

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
    return distance, farthest


@inlined
def _quarter(t: Floats, waiting: Floats, top: int) -> int:
    """Put the four triangles between a triangle's corners and its edges' middles on the stack."""
    for a in range(3):
        x, y, z = t[a], t[3 + a], t[6 + a]
        xy, yz, zx = 0.5 * (x + y), 0.5 * (y + z), 0.5 * (z + x)
        waiting[top, a], waiting[top, 3 + a], waiting[top, 6 + a] = x, xy, zx
        waiting[top + 1, a], waiting[top + 1, 3 + a], waiting[top + 1, 6 + a] = xy, y, yz
        waiting[top + 2, a], waiting[top + 2, 3 + a], waiting[top + 2, 6 + a] = zx, yz, z
        waiting[top + 3, a], waiting[top + 3, 3 + a], waiting[top + 3, 6 + a] = xy, yz, zx
    return top + 4


@compiled(SCALAR(MATRIX, SURFACES, SPANS, types.boolean, SCALAR, SCALAR))
def largest_distance(
    triangles: Floats, surfaces: SurfaceTables, spans: np.ndarray, solid: bool, tolerance: float, enough: float
) -> float:
    """Upper bound of the distance from points of triangles to a surface or a body, at most `tolerance` too large.

    Args:
        triangles: Corners, nine numbers each, shape (n, 9) [m].
        surfaces: All surfaces.
        spans: Where the trees of the surface stand, shape (k, 4).
        solid: Whether they are solids, so that what is inside one is at no distance.
        tolerance: How much too large the result may be [m], positive.
        enough: A distance beyond which it doesn't matter how large it is [m].

    Returns:
        The bound [m]; if it is above `enough`, only that the largest distance may be above `enough` too.
    """
    known = bound = 0.0
    waiting = np.zeros((_STACK, 9))
    triangle, before = np.zeros(9), np.zeros((2, 5))
    before[0, 3] = math.inf
    for i in range(triangles.shape[0]):
        waiting[0] = triangles[i]
        top = 1
        while top > 0:
            top -= 1
            triangle[:] = waiting[top]
            distance, farthest = _bounds(triangle, surfaces, spans, solid, known + tolerance, before)
            known = max(known, distance if farthest > known + tolerance or not solid else 0.0)
            if known > enough:
                return known
            if farthest > known + tolerance:
                top = _quarter(triangle, waiting, top)
            else:
                bound = max(bound, farthest)
    return max(known, bound)
