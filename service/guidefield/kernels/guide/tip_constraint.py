"""The tip's constraint while a robot descends (a plane, with or without an orientation, or a place), and its guard.

`descent.py` and `plane_rounds.py` keep it, and all minimizers the guard; `planner/guide` fills the tables and
reads the counts by columns. A kind is how many rows `constraint_error` and `constraint_rows` write: all different.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from guidefield.kernels.jit.arrays import INDICES_OUT, Floats, Row, RowOut, Rows, RowsOut, Vector3, numba_type
from guidefield.kernels.jit.decorators import inlined, kernel
from guidefield.kernels.kinematics.integrate import Mover, tip_jacobian, tip_position

EVALUATIONS, JUDGED, STEPS, ROUNDS, REFUSED, COUNTS = range(6)
"""Columns of counts: evaluations of U or of its forces; motions judged; steps of descents; rounds towards a plane; ends
of the motion that was refused in the last of them, 2 or 0; then how many columns there are."""

COUNTS_OUT = INDICES_OUT  # a row of them, shape (COUNTS,)

ON_PLANE, HELD, SLIDING = 1, 3, 4
"""Kinds, by the count of numbers that stay zero: height above a plane; displacement from a point; height, rotation."""


class TipConstraint(NamedTuple):
    """Some numbers about the tip that stay zero."""

    kind: int  # which, and how many
    point: RowOut  # a point of the plane, or where the tip is held, shape (3,) [m]
    normal: RowOut  # the plane's unit normal, shape (3,)
    rotation: RowsOut  # the orientation that is kept while sliding, shape (3, 3)


CONSTRAINT = numba_type(TipConstraint)  # its arrays may be written to: a kernel moves it from round to round


@inlined
def constraint_error(constraint: TipConstraint, mover: Mover, world: Floats, origin: Floats, error_out: Floats) -> None:
    """Write how far a constraint's numbers (kind,) are from 0, placements (n, 3, 4) about `origin` (3,) [m or rad]."""
    tip, point, normal = tip_position(mover, world), constraint.point, constraint.normal
    dx, dy, dz = tip[0] + origin[0] - point[0], tip[1] + origin[1] - point[1], tip[2] + origin[2] - point[2]
    if constraint.kind == HELD:
        error_out[0], error_out[1], error_out[2] = dx, dy, dz
        return
    error_out[0] = normal[0] * dx + normal[1] * dy + normal[2] * dz
    if constraint.kind == SLIDING:
        T, R = world[mover.tip_joint], np.empty((3, 3))
        for r in range(3):
            for c in range(3):  # T tip rotation^T
                value = 0.0
                for k in range(3):
                    row = T[r, 0] * mover.tip[0, k] + T[r, 1] * mover.tip[1, k] + T[r, 2] * mover.tip[2, k]
                    value += row * constraint.rotation[c, k]
                R[r, c] = value
        x, y, z = 0.5 * (R[2, 1] - R[1, 2]), 0.5 * (R[0, 2] - R[2, 0]), 0.5 * (R[1, 0] - R[0, 1])
        sine = math.sqrt(x * x + y * y + z * z)
        cosine = 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0)
        scale = math.atan2(sine, cosine) / sine if sine > 1e-12 else 1.0
        error_out[1], error_out[2], error_out[3] = scale * x, scale * y, scale * z


@inlined
def constraint_rows(
    constraint: TipConstraint, mover: Mover, world: Floats, subspaces: Floats, jacobian: Floats, rows_out: Floats
) -> None:
    """Write the derivative (kind, nv) of a constraint's numbers by the group's tangent; scratch (6, nv).

    Placements (n, 3, 4) [m] and motion subspaces (m, 6) are about the same origin.
    """
    tip_jacobian(mover, subspaces, tip_position(mover, world), jacobian)
    normal = constraint.normal
    for k in range(jacobian.shape[1]):
        if constraint.kind == HELD:
            rows_out[0, k], rows_out[1, k], rows_out[2, k] = jacobian[0, k], jacobian[1, k], jacobian[2, k]
            continue
        rows_out[0, k] = normal[0] * jacobian[0, k] + normal[1] * jacobian[1, k] + normal[2] * jacobian[2, k]
        if constraint.kind == SLIDING:
            rows_out[1, k], rows_out[2, k], rows_out[3, k] = jacobian[3, k], jacobian[4, k], jacobian[5, k]


class TipGuard(NamedTuple):
    """A convex polygon of k edges, and how far from it the tip may be."""

    origin: Row  # a point of its plane, shape (3,) [m]
    axes: Rows  # two unit vectors of its plane, shape (2, 3)
    inward: Rows  # unit normals of the edges to the inside, shape (k, 2)
    offsets: Row  # height over edge i is ``inward[i] . x - offsets[i]``, shape (k,) [m].
    corners: Rows  # corners of the inset polygon, shape (m, 2) [m]
    inset: float  # how far inside the edges the inset polygon lies [m]
    farthest: float  # the largest distance from the inset polygon that is allowed [m]
    depth: float  # the smallest height over the edges that is allowed [m]; minus infinity for any


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
    """Tell if the tip may be at a point."""
    if guard.depth > -math.inf:
        u, v = _foot(guard, p)
        if _depth(guard, u, v) < guard.depth:
            return False
    if guard.farthest < math.inf:
        c = closest(guard, p)
        gap = (c[0] - p[0]) ** 2 + (c[1] - p[1]) ** 2 + (c[2] - p[2]) ** 2
        return gap <= guard.farthest * guard.farthest
    return True


@kernel
def closest_point(guard: TipGuard, point: Row, point_out: RowOut) -> None:
    """`closest` for a point of shape (3,) [m, world], into one of shape (3,)."""
    point_out[0], point_out[1], point_out[2] = closest(guard, (point[0], point[1], point[2]))
