"""A test that two bodies made of convex parts keep a distance: GJK in float64, and trees of balls about many parts.

GJK after Gilbert, Johnson and Keerthi (1988). With v the point of the simplex in the difference A - B nearest to the
origin and w the support point of A - B against v, the distance is at least v.w / |v| and at most |v|: the first says
that a pair is apart, and only it; what is not known to be apart after `ROUNDS` rounds counts as touching.
"""

from __future__ import annotations

import math

import numpy as np
from numba import boolean, types

from guidefield.kernels.collide.balls import ball_radius
from guidefield.kernels.collide.gjk_scratch import (
    POSE_A,
    POSE_B,
    STACK,
    axis_in,
    origins_apart,
    place_ball,
    place_part,
    place_part_of,
    write_axis,
)
from guidefield.kernels.collide.gjk_simplex import has_point, nearest_point, reduced_with
from guidefield.kernels.collide.parts import (
    BLOCKS,
    DISC,
    FIRST_BLOCK,
    HALF_LENGTH,
    KIND,
    LEFT,
    PART,
    PLANE_OFFSET,
    POINTED_PARTS,
    POLYTOPE,
    RIGHT,
    SHAPE,
    TRIANGLE,
    Parts,
    child_of,
    is_flat_sided,
    is_leaf,
    kind_of,
    part_of,
    rounding,
    splits_first,
)
from guidefield.kernels.collide.primitive import CYLINDER, HALF_SPACE
from guidefield.kernels.jit.signatures import (
    DOUBLE_POINTER,
    Floats,
    Floats32,
    Integers,
    lane_part,
    lane_step,
)
from guidefield.kernels.linalg.small_systems import unit_in_plane
from guidefield.kernels.simd.blocks import BLOCK, point_at, points_at
from guidefield.kernels.simd.vector import ALL_LANES, below, first_lane, lane, largest_lane, select, splat

ROUNDS, BALL_ROUNDS = 32, 1
"""Most rounds of GJK with two parts, and where one of them is but a ball."""

PLACED = (POINTED_PARTS, types.int64, DOUBLE_POINTER)
"""Tables, a node or part in them, the placement of its body."""

NODE_A, NODE_B, ENTRY = range(3)
"""Numbers of an entry of the stack: a node of each body; then how many there are."""


@lane_part
def _farthest_vertex(
    vertices: Floats32, first: int, blocks: int, x: float, y: float, z: float
) -> tuple[float, float, float]:
    """The vertex farthest along a direction."""
    best, at = splat(-1e30), splat(0.0)
    for block in range(blocks):
        base = (first + block) * BLOCK
        u, v, w = points_at(vertices, base)
        along = u * x + v * y + w * z
        at = select(best < along, splat(float(block)), at)
        best = select(best < along, along, best)
    winner = first_lane(ALL_LANES & ~below(best, splat(largest_lane(best))))
    place = (first + int(lane(at, winner))) * BLOCK + winner
    u, v, w = point_at(vertices, place)
    return float(u), float(v), float(w)


@lane_part
def _farthest_corner(numbers: Floats, at: int, x: float, y: float, z: float) -> int:
    """Return where the corner of a triangle farthest along a direction begins: 0, 3 or 6."""
    farthest, best = 0, numbers[at] * x + numbers[at + 1] * y + numbers[at + 2] * z
    for corner in (3, 6):
        along = numbers[at + corner] * x + numbers[at + corner + 1] * y + numbers[at + corner + 2] * z
        if along > best:
            farthest, best = corner, along
    return farthest


@lane_part
def support(
    shapes: Integers,
    numbers: Floats,
    vertices: Floats32,
    part: int,
    work: Floats,
    pose: int,
    dx: float,
    dy: float,
    dz: float,
) -> tuple[float, float, float]:
    """The point of a part (without what rounds it) farthest along a direction, in the world.

    The tables are those of `Parts`; the pose (12,) that places the part stands in the scratch space, shape (WORK,).
    """
    x = work[pose] * dx + work[pose + 4] * dy + work[pose + 8] * dz
    y = work[pose + 1] * dx + work[pose + 5] * dy + work[pose + 9] * dz
    z = work[pose + 2] * dx + work[pose + 6] * dy + work[pose + 10] * dz
    px, py, pz = 0.0, 0.0, 0.0
    if part >= 0:  # else a ball's centre
        kind, at = shapes[SHAPE * part + KIND], part * PART
        if kind == POLYTOPE:
            first, blocks = shapes[SHAPE * part + FIRST_BLOCK], shapes[SHAPE * part + BLOCKS]
            px, py, pz = _farthest_vertex(vertices, first, blocks, x, y, z)
        elif kind == TRIANGLE:
            at += _farthest_corner(numbers, at, x, y, z)
            px, py, pz = numbers[at], numbers[at + 1], numbers[at + 2]
        else:
            pz = math.copysign(numbers[at + HALF_LENGTH], z)
            if kind == CYLINDER:
                ux, uy = unit_in_plane(x, y)
                px, py = numbers[at + DISC] * ux, numbers[at + DISC] * uy
    return (
        work[pose] * px + work[pose + 1] * py + work[pose + 2] * pz + work[pose + 3],
        work[pose + 4] * px + work[pose + 5] * py + work[pose + 6] * pz + work[pose + 7],
        work[pose + 8] * px + work[pose + 9] * py + work[pose + 10] * pz + work[pose + 11],
    )


@lane_part
def over_plane(a: Parts, part_a: int, b: Parts, part_b: int, work: Floats) -> float:
    """Return how far a part, without what rounds it, is over a half-space's plane [m], whose normal is the axis now.

    The pose that places the part stands in the scratch space, shape (WORK,).
    """
    at = PART * part_b
    nx, ny, nz = b.numbers[at], b.numbers[at + 1], b.numbers[at + 2]
    px, py, pz = support(a.shapes, a.numbers, a.vertices, part_a, work, POSE_A, -nx, -ny, -nz)
    write_axis(work, nx, ny, nz)
    return float(nx * px + ny * py + nz * pz - b.numbers[at + PLANE_OFFSET])


@lane_step(boolean(POINTED_PARTS, types.int64, POINTED_PARTS, types.int64, types.float64, DOUBLE_POINTER, types.int64))
def _apart(a: Parts, part_a: int, b: Parts, part_b: int, margin: float, work: Floats, most: int) -> bool:
    """Tell if two parts, placed by the poses in `work`, are shown to be farther apart than a margin in so many rounds.

    The last axis is tried first.
    """
    shapes_a, numbers_a, vertices_a = a.shapes, a.numbers, a.vertices
    shapes_b, numbers_b, vertices_b = b.shapes, b.numbers, b.vertices
    vx, vy, vz = axis_in(work)
    if part_b >= 0 and kind_of(b, part_b) == HALF_SPACE:
        return over_plane(a, part_a, b, part_b, work) > margin
    square, count = vx * vx + vy * vy + vz * vz, 0
    if not square > 1e-20:
        vx, vy, vz, square = 1.0, 0.0, 0.0, 1.0
    for rounds in range(most):
        ax, ay, az = support(shapes_a, numbers_a, vertices_a, part_a, work, POSE_A, -vx, -vy, -vz)
        bx, by, bz = support(shapes_b, numbers_b, vertices_b, part_b, work, POSE_B, vx, vy, vz)
        wx, wy, wz = ax - bx, ay - by, az - bz
        along = vx * wx + vy * wy + vz * wz
        if along > margin * math.sqrt(square):
            write_axis(work, vx, vy, vz)
            return True
        if rounds > 0 and square - along <= 1e-9 * square:
            return False
        if has_point(work, count, wx, wy, wz):
            return False
        count = reduced_with(work, count, wx, wy, wz)
        vx, vy, vz = nearest_point(work)
        square = vx * vx + vy * vy + vz * vz
        if count == 4 or square <= margin * margin or square < 1e-16:
            return False
    return False


@lane_step(types.float64(POINTED_PARTS, types.int64, DOUBLE_POINTER, types.float64, types.float64, types.float64))
def reach_along(parts: Parts, part: int, work: Floats, dx: float, dy: float, dz: float) -> float:
    """Return how far a part of a body that stands at the origin reaches along a unit direction in its frame [m].

    Scratch `work` has the shape (WORK,).
    """
    at = PART * part
    if kind_of(parts, part) == HALF_SPACE:
        return float(parts.numbers[at + PLANE_OFFSET])
    if is_flat_sided(parts, part):
        for k in range(12):
            work[POSE_B + k] = 1.0 if k in (0, 5, 10) else 0.0
    else:
        for k in range(12):
            work[POSE_B + k] = parts.numbers[at + k]
    x, y, z = support(parts.shapes, parts.numbers, parts.vertices, part, work, POSE_B, dx, dy, dz)
    return float(x * dx + y * dy + z * dz + rounding(parts, part))


@lane_step(boolean(*PLACED, *PLACED, types.float64, DOUBLE_POINTER))
def bodies_apart(
    a: Parts, root_a: int, pose_a: Floats, b: Parts, root_b: int, pose_b: Floats, margin: float, work: Floats
) -> bool:
    """Tell if two bodies are farther apart than a margin.

    Args:
        a: Tables that the first body is in.
        root_a: Root of its tree of balls.
        pose_a: Its placement, rotation and translation row by row, shape (12,) [m].
        b: Tables that the second is in; only it may be a half-space.
        root_b: Its root.
        pose_b: Its placement, (12,).
        margin: What they have to keep [m], >= 0.
        work: Scratch, shape (WORK,); the last axis in it is where the search starts, and is left there.
    """
    top = STACK + ENTRY
    work[STACK + NODE_A], work[STACK + NODE_B] = root_a, root_b
    while top > STACK:
        top -= ENTRY
        node_a, node_b = int(work[top + NODE_A]), int(work[top + NODE_B])
        radius_a, radius_b = ball_radius(a.balls, node_a), ball_radius(b.balls, node_b)
        part_a, part_b = part_of(a, node_a), part_of(b, node_b)
        place_ball(a, node_a, pose_a, work, POSE_A)
        place_ball(b, node_b, pose_b, work, POSE_B)
        reach = radius_a + radius_b + margin
        if radius_b < np.inf and origins_apart(work) > reach * reach:
            continue
        reach = place_part_of(a, node_a, pose_a, work, POSE_A) + place_part_of(b, node_b, pose_b, work, POSE_B) + margin
        # a ball alone tells little: its children are soon asked
        most = ROUNDS if part_a >= 0 and part_b >= 0 else BALL_ROUNDS
        if (part_a >= 0 or part_b >= 0) and _apart(a, part_a, b, part_b, reach, work, most):
            continue
        if is_leaf(a, node_a) and is_leaf(b, node_b):
            return False
        split_a = splits_first(a, node_a, b, node_b)
        for side in (LEFT, RIGHT):
            work[top + NODE_A] = child_of(a, node_a, side) if split_a else node_a
            work[top + NODE_B] = node_b if split_a else child_of(b, node_b, side)
            top += ENTRY
    return True


@lane_step(boolean(*PLACED, *PLACED, types.float64, DOUBLE_POINTER))
def parts_apart(
    a: Parts, part_a: int, pose_a: Floats, b: Parts, part_b: int, pose_b: Floats, margin: float, work: Floats
) -> bool:
    """`bodies_apart` for two parts; same shapes."""
    place_part(a, part_a, pose_a, work, POSE_A)
    place_part(b, part_b, pose_b, work, POSE_B)
    margin += rounding(a, part_a) + rounding(b, part_b)
    return bool(_apart(a, part_a, b, part_b, margin, work, ROUNDS))
