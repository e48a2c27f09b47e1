"""Bounds of the distance of two convex solids, for the judge of streams.

A solid is the hull of points, swept by a disc about its axis, rounded by a ball: all bodies that there are. For a unit
direction d the gap  min_A d.x - max_B d.x - r_A - r_B  is a lower bound of the distance, whatever led to d: rounding
and faults of the search can cost a proof, and never make one. The directions are Gilbert, Johnson and Keerthi's.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import float64, int64, types

from guidefield.kernels.collide.gjk_simplex import has_point, nearest_point, reduced_with
from guidefield.kernels.jit.fields import Indices, Row, Rows, numba_type
from guidefield.kernels.jit.signatures import DOUBLE_POINTER, SCALAR, VECTOR, Floats, Vector3, lane_part, lane_step
from guidefield.kernels.kinematics.poses import placed, turned_back


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
"""If the bounds from both sides are this close, no direction is much better [m]."""

PARALLEL = 2e-15
"""A direction whose part across an axis is no larger than this share of it is parallel to the axis."""


@lane_part
def _unit_across(
    x: float, y: float, z: float, axis_x: float, axis_y: float, axis_z: float
) -> tuple[float, float, float]:
    """The unit vector across a unit axis that is nearest to a direction; 0 if they are parallel up to rounding.

    What one projection leaves of a nearly parallel direction can point along the axis, so the direction is projected
    twice.
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
def _furthest(solids: Solids, k: int, pose: Floats, x: float, y: float, z: float) -> Vector3:
    """The point of a solid, in the world and without its rounding, that is furthest in a direction of the world [m].

    Args:
        solids: The solids.
        k: Which one.
        pose: Of what carries it: rotation by rows and translation, shape (12,) [m].
        x: The direction, with y and z.
        y: See x.
        z: See x.
    """
    dx, dy, dz = turned_back(pose, x, y, z)
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
    return placed(pose, px, py, pz)


@lane_step(types.UniTuple(float64, 2)(SOLIDS, int64, VECTOR, SOLIDS, int64, VECTOR, SCALAR, SCALAR, DOUBLE_POINTER))
def apart(
    a: Solids, i: int, here: Floats, b: Solids, j: int, there: Floats, wanted: float, needed: float, simplex: Floats
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
        simplex: Scratch, shape (`SIMPLEX`,).
    """
    ca, cb = a.balls[i], b.balls[j]
    x, y, z = placed(here, ca[0], ca[1], ca[2])
    u, v, w = placed(there, cb[0], cb[1], cb[2])
    x, y, z = x - u, y - v, z - w
    rounding = a.rounding[i] + b.rounding[j]
    lower, upper, size = -np.inf, np.inf, 0
    for _ in range(ROUNDS):
        length = math.sqrt(x * x + y * y + z * z)
        if size > 0:
            upper = length - rounding
        if length < 1e-12:
            if size > 0:
                return lower, -rounding
            x, y, z, length = 1.0, 0.0, 0.0, 1.0
        x, y, z = x / length, y / length, z / length
        px, py, pz = _furthest(a, i, here, -x, -y, -z)
        qx, qy, qz = _furthest(b, j, there, x, y, z)
        px, py, pz = px - qx, py - qy, pz - qz
        lower = max(lower, x * px + y * py + z * pz - rounding)
        if lower > wanted or upper <= needed or upper - lower < CONVERGED or size == 4:
            return lower, upper
        if has_point(simplex, size, px, py, pz):
            return lower, upper
        size = reduced_with(simplex, size, px, py, pz)
        x, y, z = nearest_point(simplex)
    return lower, upper
