"""Distance of two convex parts: GJK in float64, and a bound where it is farther than what is asked for.

With v the point of the simplex in the difference A - B nearest to the origin and w the support point of A - B against
v, the distance is at least v.w / |v| and at most |v| (see `collide.gjk`): the search ends when these differ by less
than `ACCURACY`.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types

from guidefield.kernels.collide.gjk import over_plane, support
from guidefield.kernels.collide.gjk_scratch import POSE_A, POSE_B, axis_in, write_axis
from guidefield.kernels.collide.gjk_simplex import has_point, nearest_point, reduced_with
from guidefield.kernels.collide.parts import POINTED_PARTS, Parts, kind_of
from guidefield.kernels.collide.primitive import HALF_SPACE
from guidefield.kernels.jit.signatures import DOUBLE_POINTER, Floats, lane_step

ACCURACY = 2e-7
"""By how much a distance may be too large [m]."""

ROUNDS, FEW_ROUNDS = 64, 5
"""After how many rounds GJK has what it finds (with rounded parts it comes closer by a factor each time), and where a
bound is enough."""


@lane_step(
    types.float64(
        POINTED_PARTS,
        types.int64,
        POINTED_PARTS,
        types.int64,
        types.float64,
        types.float64,
        types.float64,
        types.int64,
        DOUBLE_POINTER,
    )
)
def parts_distance(
    a: Parts, part_a: int, b: Parts, part_b: int, rounding: float, least: float, most: float, rounds: int, work: Floats
) -> float:
    """Distance of two parts that are placed by the poses in the scratch space, less what rounds them [m].

    Args:
        a: Tables that the first part is in.
        part_a: The part, or -1 for a point at the origin of its pose.
        b: Tables that the second is in; only it may be a half-space.
        part_b: The part, or -1.
        rounding: Radii of what rounds both, together [m].
        least: If they are no farther apart than this, some bound of their distance is enough that is no more than it
            [m]; minus infinity: none.
        most: If they are farther apart than this, some bound of their distance that is no less than it is enough [m].
        rounds: How long GJK goes on at most: fewer than `ROUNDS` give a bound of the distance.
        work: Scratch, shape (WORK,), with the poses; the search begins with the axis in it, and leaves its last one.

    Returns:
        The distance, at most `ACCURACY` too large; not above -rounding where the parts overlap without what rounds
        them.
    """
    if part_b >= 0 and kind_of(b, part_b) == HALF_SPACE:
        return over_plane(a, part_a, b, part_b, work) - rounding
    vx, vy, vz = axis_in(work)
    square, count, lower = vx * vx + vy * vy + vz * vz, 0, -np.inf
    if not square > 1e-20:
        vx, vy, vz, square = 1.0, 0.0, 0.0, 1.0
    near = least + rounding
    for done in range(rounds):
        ax, ay, az = support(a.shapes, a.numbers, a.vertices, part_a, work, POSE_A, -vx, -vy, -vz)
        bx, by, bz = support(b.shapes, b.numbers, b.vertices, part_b, work, POSE_B, vx, vy, vz)
        wx, wy, wz = ax - bx, ay - by, az - bz
        length = math.sqrt(square)
        lower = max(lower, (vx * wx + vy * wy + vz * wz) / length)
        if lower - rounding >= most:
            write_axis(work, vx, vy, vz)
            return lower - rounding
        if done > 0 and length - lower <= ACCURACY:
            break
        if has_point(work, count, wx, wy, wz):
            break
        count = reduced_with(work, count, wx, wy, wz)
        vx, vy, vz = nearest_point(work)
        square = vx * vx + vy * vy + vz * vz
        if count == 4 or square < 1e-16:
            return -rounding
        if square <= near * abs(near):
            write_axis(work, vx, vy, vz)
            return lower - rounding
        if done == rounds - 1 and rounds < ROUNDS:
            write_axis(work, vx, vy, vz)
            return lower - rounding
    write_axis(work, vx, vy, vz)
    return math.sqrt(square) - rounding
