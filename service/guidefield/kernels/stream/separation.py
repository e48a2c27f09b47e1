"""How far apart two convex solids are at least: for the judge of streams alone.

A solid is the hull of points, swept by a disc about its axis, rounded by a ball: all bodies that there are. For a unit
direction d the gap  min_A d.x - max_B d.x - r_A - r_B  is a lower bound of the distance, whatever led to d: rounding
and faults of the search can cost a proof, and never make one. The directions are Gilbert, Johnson and Keerthi's.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import float64, int64, types

from guidefield.kernels.jit.fields import Indices, Row, Rows, numba_type
from guidefield.kernels.jit.signatures import MATRIX_OUT, SCALAR, VECTOR, Floats, lane_part, lane_step


class Solids(NamedTuple):
    """Convex solids in the frames of what carries them.

    Attributes:
        first, counts: Which of `points` are whose, shape (n,).
        points: Shape (p, 3) [m].
        disc: Radius of the disc that is swept over them, across `axis`, shape (n,) [m].
        axis: Unit vectors, shape (n, 3); used where there is a disc.
        rounding: Radius of the ball that is swept over all that, shape (n,) [m].
        balls: Centre and radius of a ball about each, shape (n, 4) [m].
    """

    first: Indices
    counts: Indices
    points: Rows
    disc: Row
    axis: Rows
    rounding: Row
    balls: Rows


SOLIDS = numba_type(Solids)

ROUNDS = 24
"""Directions that are tried."""

CONVERGED = 1e-6
"""Where the bounds from both sides are as close, no direction is much better [m]."""

PARALLEL = 2e-15
"""A direction whose part across an axis is no larger than this share of it is parallel to the axis."""


@lane_part
def _unit_across(
    x: float, y: float, z: float, axis_x: float, axis_y: float, axis_z: float
) -> tuple[float, float, float]:
    """The unit vector across a unit axis that is nearest to a direction; 0 if they are parallel up to rounding.

    What one projection leaves of a nearly parallel direction can point along the axis, so the direction is projected
    twice. `kernels.certificate.discs` does the same; both judges share no code.
    """
    size = max(abs(x), abs(y), abs(z))
    if not size > 0.0:
        return 0.0, 0.0, 0.0
    x, y, z = x / size, y / size, z / size
    for _ in range(2):
        along = x * axis_x + y * axis_y + z * axis_z
        x, y, z = x - along * axis_x, y - along * axis_y, z - along * axis_z
    across = math.sqrt(x * x + y * y + z * z)
    if across <= PARALLEL:
        return 0.0, 0.0, 0.0
    return x / across, y / across, z / across


@lane_part
def _furthest(solids: Solids, k: int, pose: Floats, x: float, y: float, z: float, out: Floats) -> None:
    """The point of a solid, in the world and without its rounding, that is furthest in a direction of the world.

    Args:
        solids: The solids.
        k: Which one.
        pose: Of what carries it: rotation by rows and translation, shape (12,) [m].
        x: The direction.
        y: Its second part.
        z: Its third.
        out: Shape (3,) [m, world].
    """
    dx = pose[0] * x + pose[4] * y + pose[8] * z
    dy = pose[1] * x + pose[5] * y + pose[9] * z
    dz = pose[2] * x + pose[6] * y + pose[10] * z
    points, first = solids.points, solids.first[k]
    best, most = first, -np.inf
    for i in range(first, first + solids.counts[k]):
        along = points[i, 0] * dx + points[i, 1] * dy + points[i, 2] * dz
        if along > most:
            best, most = i, along
    px, py, pz = points[best, 0], points[best, 1], points[best, 2]
    disc = solids.disc[k]
    if disc > 0.0:
        ux, uy, uz = _unit_across(dx, dy, dz, solids.axis[k, 0], solids.axis[k, 1], solids.axis[k, 2])
        px, py, pz = px + disc * ux, py + disc * uy, pz + disc * uz
    out[0] = pose[0] * px + pose[1] * py + pose[2] * pz + pose[3]
    out[1] = pose[4] * px + pose[5] * py + pose[6] * pz + pose[7]
    out[2] = pose[8] * px + pose[9] * py + pose[10] * pz + pose[11]


@lane_part
def _closest_on_triangle(w: Floats, a: int, b: int, c: int, out: Floats) -> int:
    """The point of a triangle closest to the origin, and which corners it needs, as bits 1, 2 and 4.

    Args:
        w: Corners in rows, shape (4, 3) [m].
        a: Which row is the first corner.
        b: The second.
        c: The third.
        out: Shape (3,) [m].
    """
    abx, aby, abz = w[b, 0] - w[a, 0], w[b, 1] - w[a, 1], w[b, 2] - w[a, 2]
    acx, acy, acz = w[c, 0] - w[a, 0], w[c, 1] - w[a, 1], w[c, 2] - w[a, 2]
    d1 = -(abx * w[a, 0] + aby * w[a, 1] + abz * w[a, 2])
    d2 = -(acx * w[a, 0] + acy * w[a, 1] + acz * w[a, 2])
    d3 = -(abx * w[b, 0] + aby * w[b, 1] + abz * w[b, 2])
    d4 = -(acx * w[b, 0] + acy * w[b, 1] + acz * w[b, 2])
    d5 = -(abx * w[c, 0] + aby * w[c, 1] + abz * w[c, 2])
    d6 = -(acx * w[c, 0] + acy * w[c, 1] + acz * w[c, 2])
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    s, t, kept = 0.0, 0.0, 7
    if d1 <= 0.0 and d2 <= 0.0:
        kept = 1
    elif d3 >= 0.0 and d4 <= d3:
        s, kept = 1.0, 2
    elif d6 >= 0.0 and d5 <= d6:
        t, kept = 1.0, 4
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        s, kept = d1 / (d1 - d3), 3
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        t, kept = d2 / (d2 - d6), 5
    elif va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        t = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        s, kept = 1.0 - t, 6
    else:
        whole = va + vb + vc
        s, t = vb / whole, vc / whole
    out[0] = w[a, 0] + s * abx + t * acx
    out[1] = w[a, 1] + s * aby + t * acy
    out[2] = w[a, 2] + s * abz + t * acz
    return kept


@lane_part
def _reduced(w: Floats, size: int, v: Floats, tried: Floats) -> int:
    """The point of a simplex closest to the origin; leaves the corners that it needs, and says how many.

    Args:
        w: Its corners in rows, shape (4, 3) [m].
        size: How many there are.
        v: The point, shape (3,) [m].
        tried: Scratch, shape (3,).
    """
    if size == 1:
        v[0], v[1], v[2] = w[0, 0], w[0, 1], w[0, 2]
        return 1
    if size == 2:
        dx, dy, dz = w[1, 0] - w[0, 0], w[1, 1] - w[0, 1], w[1, 2] - w[0, 2]
        square = dx * dx + dy * dy + dz * dz
        t = -(dx * w[0, 0] + dy * w[0, 1] + dz * w[0, 2]) / square if square > 0.0 else 0.0
        if t >= 1.0:
            w[0, 0], w[0, 1], w[0, 2] = w[1, 0], w[1, 1], w[1, 2]
            t = 0.0
            dx = dy = dz = 0.0
        t = max(t, 0.0)
        v[0], v[1], v[2] = w[0, 0] + t * dx, w[0, 1] + t * dy, w[0, 2] + t * dz
        return 2 if t > 0.0 else 1
    if size == 3:
        kept = _closest_on_triangle(w, 0, 1, 2, v)
        return _leave(w, 0, 1, 2, kept)
    best, best_face, best_kept = np.inf, -1, 0
    for face in range(4):
        a, b, c, d = (face + 1) % 4, (face + 2) % 4, (face + 3) % 4, face
        ux, uy, uz = w[b, 0] - w[a, 0], w[b, 1] - w[a, 1], w[b, 2] - w[a, 2]
        tx, ty, tz = w[c, 0] - w[a, 0], w[c, 1] - w[a, 1], w[c, 2] - w[a, 2]
        nx, ny, nz = uy * tz - uz * ty, uz * tx - ux * tz, ux * ty - uy * tx
        origin = -(nx * w[a, 0] + ny * w[a, 1] + nz * w[a, 2])
        inner = nx * (w[d, 0] - w[a, 0]) + ny * (w[d, 1] - w[a, 1]) + nz * (w[d, 2] - w[a, 2])
        if origin * inner <= 0.0:
            kept = _closest_on_triangle(w, a, b, c, tried)
            square = tried[0] ** 2 + tried[1] ** 2 + tried[2] ** 2
            if square < best:
                best, best_face, best_kept = square, face, kept
                v[0], v[1], v[2] = tried[0], tried[1], tried[2]
    if best_face < 0:
        v[0] = v[1] = v[2] = 0.0
        return 4
    return _leave(w, (best_face + 1) % 4, (best_face + 2) % 4, (best_face + 3) % 4, best_kept)


@lane_part
def _leave(w: Floats, a: int, b: int, c: int, kept: int) -> int:
    """Leave some of three corners of a simplex, in its first rows; how many.

    Args:
        w: Corners in rows, shape (4, 3) [m].
        a: Which row is the first.
        b: The second.
        c: The third.
        kept: Bits 1, 2 and 4 for those that stay.
    """
    ax, ay, az = w[a, 0], w[a, 1], w[a, 2]
    bx, by, bz = w[b, 0], w[b, 1], w[b, 2]
    cx, cy, cz = w[c, 0], w[c, 1], w[c, 2]
    size = 0
    if kept & 1:
        w[size, 0], w[size, 1], w[size, 2] = ax, ay, az
        size += 1
    if kept & 2:
        w[size, 0], w[size, 1], w[size, 2] = bx, by, bz
        size += 1
    if kept & 4:
        w[size, 0], w[size, 1], w[size, 2] = cx, cy, cz
        size += 1
    return size


@lane_step(types.UniTuple(float64, 2)(SOLIDS, int64, VECTOR, SOLIDS, int64, VECTOR, SCALAR, SCALAR, MATRIX_OUT))
def apart(
    a: Solids, i: int, here: Floats, b: Solids, j: int, there: Floats, wanted: float, needed: float, work: Floats
) -> tuple[float, float]:
    """Bounds of the distance of two solids: no less than the first [m]; no more than the second, up to rounding.

    Args:
        a: Solids.
        i: Which one of them.
        here: Pose of what carries it, shape (12,).
        b: Others.
        j: Which one of those.
        there: Pose of what carries it, shape (12,).
        wanted: Enough is known where the first bound is above it [m].
        needed: And where the second is not above it [m].
        work: Scratch, shape (8, 3).
    """
    w, v, p, q, tried = work[:4], work[4], work[5], work[6], work[7]
    ca, cb = a.balls[i], b.balls[j]
    for k in range(3):
        v[k] = (
            here[4 * k] * ca[0] + here[4 * k + 1] * ca[1] + here[4 * k + 2] * ca[2] + here[4 * k + 3]
            - there[4 * k] * cb[0] - there[4 * k + 1] * cb[1] - there[4 * k + 2] * cb[2] - there[4 * k + 3]
        )  # fmt: skip
    rounding = a.rounding[i] + b.rounding[j]
    lower, upper, size = -np.inf, np.inf, 0
    for _ in range(ROUNDS):
        length = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
        if size > 0:
            upper = length - rounding
        if length < 1e-12:
            if size > 0:
                return lower, -rounding
            v[0], length = 1.0, 1.0
        x, y, z = v[0] / length, v[1] / length, v[2] / length
        _furthest(a, i, here, -x, -y, -z, p)
        _furthest(b, j, there, x, y, z, q)
        sx, sy, sz = p[0] - q[0], p[1] - q[1], p[2] - q[2]
        lower = max(lower, x * sx + y * sy + z * sz - rounding)
        if lower > wanted or upper <= needed or upper - lower < CONVERGED or size == 4:
            return lower, upper
        for k in range(size):
            if w[k, 0] == sx and w[k, 1] == sy and w[k, 2] == sz:
                return lower, upper
        w[size, 0], w[size, 1], w[size, 2] = sx, sy, sz
        size = _reduced(w, size + 1, v, tried)
    return lower, upper
