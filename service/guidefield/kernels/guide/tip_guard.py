"""Where the tip may be: near a convex, flat polygon, or over its inside."""

from __future__ import annotations

import math
from typing import NamedTuple

from numba import types

from guidefield.kernels.jit.fields import Row, Rows, numba_type
from guidefield.kernels.jit.signatures import VECTOR, VECTOR_OUT, Floats, Vector3, compiled, inlined


class TipGuard(NamedTuple):
    """A convex polygon of k edges, and how far from it the tip may be.

    Attributes:
        origin: A point of its plane, shape (3,) [m].
        axes: Two unit vectors of its plane, shape (2, 3).
        inward: Unit normals of the edges to the inside, shape (k, 2).
        offsets: Height over edge i is ``inward[i] . x - offsets[i]``, shape (k,) [m].
        corners: Corners of the inset polygon, shape (m, 2) [m].
        inset: How far inside the edges the inset polygon lies [m].
        farthest: The largest distance from the inset polygon that is allowed [m].
        depth: The smallest height over the edges that is allowed [m]; minus infinity for any.
    """

    origin: Row
    axes: Rows
    inward: Rows
    offsets: Row
    corners: Rows
    inset: float
    farthest: float
    depth: float


GUARD = numba_type(TipGuard)


@inlined
def _depth(guard: TipGuard, u: float, v: float) -> float:
    """Height of a point of the plane over the nearest edge; negative outside [m]."""
    least = math.inf
    for i in range(guard.offsets.shape[0]):
        least = min(least, guard.inward[i, 0] * u + guard.inward[i, 1] * v - guard.offsets[i])
    return least


@inlined
def _foot(guard: TipGuard, p: Vector3) -> tuple[float, float]:
    o, a = guard.origin, guard.axes
    x, y, z = p[0] - o[0], p[1] - o[1], p[2] - o[2]
    return a[0, 0] * x + a[0, 1] * y + a[0, 2] * z, a[1, 0] * x + a[1, 1] * y + a[1, 2] * z


@inlined
def closest(guard: TipGuard, p: Vector3) -> Vector3:
    """The point of the inset polygon that is closest to a point."""
    u, v = _foot(guard, p)
    if _depth(guard, u, v) < guard.inset:
        corners, m = guard.corners, guard.corners.shape[0]
        best, bu, bv = math.inf, u, v
        for i in range(m):
            j = i + 1 if i + 1 < m else 0
            du, dv = corners[j, 0] - corners[i, 0], corners[j, 1] - corners[i, 1]
            length = du * du + dv * dv
            share = ((u - corners[i, 0]) * du + (v - corners[i, 1]) * dv) / (length if length > 0.0 else 1.0)
            share = min(max(share, 0.0), 1.0)
            cu, cv = corners[i, 0] + share * du, corners[i, 1] + share * dv
            gap = (cu - u) ** 2 + (cv - v) ** 2
            if gap < best:
                best, bu, bv = gap, cu, cv
        u, v = bu, bv
    o, a = guard.origin, guard.axes
    return o[0] + u * a[0, 0] + v * a[1, 0], o[1] + u * a[0, 1] + v * a[1, 1], o[2] + u * a[0, 2] + v * a[1, 2]


@inlined
def allows(guard: TipGuard, p: Vector3) -> bool:
    """Whether the tip may be at a point."""
    if guard.depth > -math.inf:
        u, v = _foot(guard, p)
        if _depth(guard, u, v) < guard.depth:
            return False
    if guard.farthest < math.inf:
        c = closest(guard, p)
        gap = (c[0] - p[0]) ** 2 + (c[1] - p[1]) ** 2 + (c[2] - p[2]) ** 2
        return gap <= guard.farthest * guard.farthest
    return True


@compiled(types.void(GUARD, VECTOR, VECTOR_OUT))
def closest_point(guard: TipGuard, point: Floats, point_out: Floats) -> None:
    """`closest` for a point of shape (3,) [m, world], into one of shape (3,)."""
    point_out[0], point_out[1], point_out[2] = closest(guard, (point[0], point[1], point[2]))
