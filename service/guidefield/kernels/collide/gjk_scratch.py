"""The scratch space of GJK, and of what searches trees of balls with it: one float64 array of `WORK` numbers.

It begins with the simplex, as gjk_simplex.py lays it out. A pose is twelve numbers, rotation and translation row by
row; a stack's entry is as many numbers as who stacks it says.
"""

from __future__ import annotations

import math

from guidefield.kernels.collide.balls import ball_radius, placed_ball
from guidefield.kernels.collide.parts import PART, Parts, is_flat_sided, part_of, rounding
from guidefield.kernels.jit.signatures import Floats, lane_part
from guidefield.kernels.kinematics.poses import write_product

POSE_A, POSE_B = 16, 28
"""Places of the two poses of the parts that are compared."""

AXIS, KEPT = 40, 44
"""Place of the last separating axis, all 0 where there is none, and of another one to keep, with a reach behind it."""

LEAF_A, LEAF_B = 48, 49
"""Places of the leaves of two bodies that were nearest to each other last, each plus 1, or 0."""

STACK, WORK = 64, 512
"""Place of the stack, and the number of all numbers."""

X, Y, Z = 3, 7, 11
"""Places of its origin in a pose."""


@lane_part
def axis_in(work: Floats) -> tuple[float, float, float]:
    """The last separating axis in the scratch space, shape (WORK,); all 0 if there is none."""
    return work[AXIS], work[AXIS + 1], work[AXIS + 2]


@lane_part
def axis_length(work: Floats) -> float:
    """Length of the axis in the scratch space, shape (WORK,)."""
    return math.sqrt(work[AXIS] ** 2 + work[AXIS + 1] ** 2 + work[AXIS + 2] ** 2)


@lane_part
def write_axis(work: Floats, x: float, y: float, z: float) -> None:
    """Write the axis that the next search in the scratch space, shape (WORK,), begins with."""
    work[AXIS], work[AXIS + 1], work[AXIS + 2] = x, y, z


@lane_part
def divide_axis(work: Floats, length: float) -> None:
    """Divide the axis in the scratch space, shape (WORK,), by a length."""
    for k in range(AXIS, AXIS + 3):
        work[k] /= length


@lane_part
def origins_apart(work: Floats) -> float:
    """Return how far apart the origins of the two poses in the scratch space, shape (WORK,), are, squared [m^2]."""
    x = work[POSE_A + X] - work[POSE_B + X]
    y = work[POSE_A + Y] - work[POSE_B + Y]
    z = work[POSE_A + Z] - work[POSE_B + Z]
    return float(x * x + y * y + z * z)


@lane_part
def place_ball(parts: Parts, node: int, body: Floats, work: Floats, pose: int) -> None:
    """Write the placement of a node's ball: the rotation of its body, which is placed so (12,), and its own centre.

    It goes to a pose in the scratch space, shape (WORK,).
    """
    for r in range(3):
        for c in range(3):
            work[pose + 4 * r + c] = body[4 * r + c]
    work[pose + X], work[pose + Y], work[pose + Z] = placed_ball(body, parts.balls, node)


@lane_part
def place_part(parts: Parts, part: int, body: Floats, work: Floats, pose: int) -> None:
    """Write the placement of a part; shapes as for `place_ball`."""
    if is_flat_sided(parts, part):
        for k in range(12):
            work[pose + k] = body[k]
        return
    write_product(body, parts.numbers, part * PART, work, pose)


@lane_part
def place_part_of(parts: Parts, node: int, body: Floats, work: Floats, pose: int) -> float:
    """Place the part of a node instead of its ball, if it has one; the radius of what rounds what is placed now [m].

    Shapes are those of `place_ball`.
    """
    part = part_of(parts, node)
    if part < 0:
        return float(ball_radius(parts.balls, node))
    place_part(parts, part, body, work, pose)
    return rounding(parts, part)
