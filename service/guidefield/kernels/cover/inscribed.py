"""How deep points are in a body, and the largest balls in it that touch its surface at given points.

A body is the union of solids, each bounded by a closed surface; it may be that they overlap. Each surface is a tree in
the same tables, a row of `spans` says where.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types, void

from guidefield.kernels.distance.ray_winding import ray_winding
from guidefield.kernels.distance.triangle_distance import SURFACES, Span, SurfaceTables, surface_distance
from guidefield.kernels.jit.signatures import MATRIX, MATRIX_OUT, SCALAR, VECTOR_OUT, Floats, compiled, inlined

SPANS = types.Array(types.int64, 2, "C", readonly=True)
INTEGERS = types.Array(types.int64, 1, "C", readonly=True)

STEPS = 40
"""Shrinking ends after so many steps, if not before."""

ROUNDING = 1e-9
"""By how much what is known of a point's neighbour is believed less, as a share and in metres."""

TOUCHING = 5e-3
"""Share of its radius by which a ball may reach beyond the surface while it is shrunk."""


@inlined
def span_of(spans: np.ndarray, k: int) -> Span:
    """Row k of `spans`, shape (surfaces, 4), as a tuple."""
    return spans[k, 0], spans[k, 1], spans[k, 2], spans[k, 3]


@inlined
def no_further(distance: float, x: float, y: float, z: float) -> float:
    """A bound for a distance at a point, from the distance at a point that is (x, y, z) away; whatever rounding does.

    What is looked for within it is found as it would be without: only what is further away isn't looked at.
    """
    return (distance + math.sqrt(x * x + y * y + z * z)) * (1.0 + ROUNDING) + ROUNDING


@inlined
def gap_to(x: float, y: float, z: float, surfaces: SurfaceTables, spans: np.ndarray, bound: float) -> float:
    """Distance of a point to the nearest of all surfaces [m]; never negative.

    Args:
        x: Point in the frame of the surfaces [m], with y and z.
        y: See x.
        z: See x.
        surfaces: All surfaces.
        spans: Where their trees stand, shape (k, 4).
        bound: More than the distance [m]; may be infinite.
    """
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
    """Whether a point is in any of the solids; arguments as in `gap_to`, `spans` of shape (k, 4)."""
    for k in range(spans.shape[0]):  # noqa: SIM110 - numba has no generators here
        if ray_winding(x, y, z, surfaces, span_of(spans, k)) != 0:
            return True
    return False


@inlined
def in_ball(x: float, y: float, z: float, balls: Floats, i: int) -> bool:
    """Whether a point is for certain within ball i, rows of centre and radius, shape (n, 4) at least [m].

    If no surface enters the ball, the point is on the side where the centre is.
    """
    dx, dy, dz, radius = x - balls[i, 0], y - balls[i, 1], z - balls[i, 2], balls[i, 3] * (1.0 - ROUNDING) - ROUNDING
    within: bool = radius > 0.0 and dx * dx + dy * dy + dz * dz < radius * radius
    return within


@compiled(void(MATRIX, SURFACES, SPANS, VECTOR_OUT))
def depths_at(points: Floats, surfaces: SurfaceTables, spans: np.ndarray, depths_out: Floats) -> None:
    """How deep points are in a body, at least: radius of the largest ball about each that lies in one of the solids.

    Args:
        points: Shape (n, 3) [m].
        surfaces: All surfaces.
        spans: Where the trees of the closed ones stand, shape (k, 4).
        depths_out: Shape (n,) [m]; outside, less than zero by the distance to the body.
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


@compiled(void(MATRIX, SURFACES, SPANS, VECTOR_OUT))
def distances_at(points: Floats, surfaces: SurfaceTables, spans: np.ndarray, distances_out: Floats) -> None:
    """Distances of points to surfaces, closed or not; never negative.

    Args:
        points: Shape (n, 3) [m], in the frame of the surfaces.
        surfaces: All surfaces.
        spans: Where their trees stand, shape (k, 4).
        distances_out: Shape (n,) [m].
    """
    bound = math.inf
    for i in range(points.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        if i > 0:
            bound = no_further(distances_out[i - 1], x - points[i - 1, 0], y - points[i - 1, 1], z - points[i - 1, 2])
        distances_out[i] = gap_to(x, y, z, surfaces, spans, bound)


@compiled(void(MATRIX, MATRIX, INTEGERS, SURFACES, SPANS, SCALAR, SCALAR, MATRIX_OUT))
def tangent_balls(
    points: Floats,
    inward: Floats,
    solids: np.ndarray,
    surfaces: SurfaceTables,
    spans: np.ndarray,
    largest: float,
    slack: float,
    centres_out: Floats,
) -> None:
    """Centres of the largest balls in a solid that all but touch its surface at given points.

    A ball about p + s u, p the point and u inward, of radius s - slack, that starts too large is shrunk: the point q of
    the surface that is nearest to its centre is on the one with s = (|w|^2 - slack^2) / (2 (u.w - slack)), w = q - p.
    What is nearest of all is found after a few steps. The slack lets a ball grow past the facets next to its own, which
    would stop it early. Source, without slack: J. Ma, S. W. Bae and S. Choi, "3D medial axis point approximation using
    nearest neighbors and the normal field", The Visual Computer 28, 2012.

    Args:
        points: Points on the surface, shape (n, 3) [m].
        inward: Unit normals at the points, into the solid, shape (n, 3).
        solids: On which solid's surface each is, shape (n,).
        surfaces: All surfaces.
        spans: Where each solid's tree stands, shape (k, 4).
        largest: Distance of the centre to start from [m].
        slack: By how much a ball may miss its point [m].
        centres_out: Shape (n, 3) [m].
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
