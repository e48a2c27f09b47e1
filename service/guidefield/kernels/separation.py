"""Whether two bodies made of convex parts keep a distance: GJK in float64, and trees of balls about many parts.

GJK after Gilbert, Johnson and Keerthi (1988). With v the point of the simplex in the difference A - B nearest to the
origin and w the support point of A - B against v, the distance is at least v.w / |v| and at most |v|: the first says
that a pair is apart, and only it; what is not known to be apart after `ROUNDS` rounds counts as touching.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import boolean, types

from guidefield.kernels.lane_math import BOX, CYLINDER, HALF_SPACE, Floats32
from guidefield.kernels.lanes import (
    ALL_LANES,
    FLOATS,
    LANES,
    below,
    first_lane,
    lane,
    lane_kernel,
    lane_part,
    largest_lane,
    load,
    number,
    splat,
    where_below,
)
from guidefield.kernels.signatures import VECTOR, VECTOR_OUT, Floats
from guidefield.kernels.simplex import NEAREST, reduced
from guidefield.kernels.tree_kinematics import INDICES

POLYTOPE = 4
"""The kind of a part that is the hull of vertices; the others are lane_math's BOX, CYLINDER, CAPSULE."""

PART = 16
"""Numbers of a part: placement in the body's frame (12, row by row), half extents (3), radius of what rounds it."""

BLOCK = 3 * LANES
"""Floats of sixteen vertices: x, y, z of all."""

ROUNDS = 32

WORK = 512
"""Numbers of scratch space: simplex, poses of a and b, the last separating axis, a stack."""
_POSE_A, _POSE_B, _STACK = 16, 28, 64

AXIS = 40
"""Where in the scratch space the last separating axis stands; zero where there is none."""


class Parts(NamedTuple):
    """Convex parts of bodies, and trees of balls about them; lengths [m] in the frame of the body.

    Attributes:
        balls: (4 * nodes,) centre and radius of each node's ball; float64.
        links: (3 * nodes,) left child, right child, part; a leaf has no children (-1), another node no part (-1).
        shapes: (3 * parts,) kind, first block of vertices, how many blocks.
        numbers: (PART * parts,) float64.
        vertices: (BLOCK * blocks,) float32; unused places repeat a vertex.
    """

    balls: np.ndarray
    links: np.ndarray
    shapes: np.ndarray
    numbers: np.ndarray
    vertices: np.ndarray


PARTS = types.NamedTuple([VECTOR, INDICES, INDICES, VECTOR, FLOATS], Parts)


@lane_part
def _farthest_vertex(
    vertices: Floats32, first: int, blocks: int, x: float, y: float, z: float
) -> tuple[float, float, float]:
    """The vertex farthest along a direction."""
    best, at = splat(-1e30), splat(0.0)
    for block in range(blocks):
        base = (first + block) * BLOCK
        along = load(vertices, base) * x + load(vertices, base + 16) * y + load(vertices, base + 32) * z
        at = where_below(best, along, splat(float(block)), at)
        best = where_below(best, along, along, best)
    winner = first_lane(ALL_LANES & ~below(best, splat(largest_lane(best))))
    place = (first + int(lane(at, winner))) * BLOCK + winner
    return (
        float(number(vertices, place)),
        float(number(vertices, place + 16)),
        float(number(vertices, place + 32)),
    )


@lane_kernel(types.UniTuple(types.float64, 3)(PARTS, types.int64, VECTOR_OUT, types.int64, *[types.float64] * 3))
def _support(
    parts: Parts, part: int, work: Floats, pose: int, dx: float, dy: float, dz: float
) -> tuple[float, float, float]:
    """The point of a part (without what rounds it) farthest along a direction, in the world."""
    x = number(work, pose) * dx + number(work, pose + 4) * dy + number(work, pose + 8) * dz
    y = number(work, pose + 1) * dx + number(work, pose + 5) * dy + number(work, pose + 9) * dz
    z = number(work, pose + 2) * dx + number(work, pose + 6) * dy + number(work, pose + 10) * dz
    px, py, pz = 0.0, 0.0, 0.0
    if part >= 0:  # else a ball's centre
        kind, at = number(parts.shapes, 3 * part), part * PART
        if kind == POLYTOPE:
            px, py, pz = _farthest_vertex(
                parts.vertices, number(parts.shapes, 3 * part + 1), number(parts.shapes, 3 * part + 2), x, y, z
            )
        else:
            pz = math.copysign(number(parts.numbers, at + 14), z)
            if kind == BOX:
                px = math.copysign(number(parts.numbers, at + 12), x)
                py = math.copysign(number(parts.numbers, at + 13), y)
            elif kind == CYLINDER:
                scale = number(parts.numbers, at + 12) / max(math.sqrt(x * x + y * y), 1e-300)
                px, py = x * scale, y * scale
    return (
        number(work, pose) * px + number(work, pose + 1) * py + number(work, pose + 2) * pz + number(work, pose + 3),
        number(work, pose + 4) * px
        + number(work, pose + 5) * py
        + number(work, pose + 6) * pz
        + number(work, pose + 7),
        number(work, pose + 8) * px
        + number(work, pose + 9) * py
        + number(work, pose + 10) * pz
        + number(work, pose + 11),
    )


@lane_kernel(boolean(PARTS, types.int64, PARTS, types.int64, types.float64, VECTOR_OUT))
def _apart(a: Parts, part_a: int, b: Parts, part_b: int, margin: float, work: Floats) -> bool:
    """Whether two parts, placed by the poses in `work`, are farther apart than a margin >= 0; starts from the last axis."""
    vx, vy, vz = work[AXIS], work[AXIS + 1], work[AXIS + 2]
    if part_b >= 0 and b.shapes[3 * part_b] == HALF_SPACE:
        nx, ny, nz = b.numbers[PART * part_b], b.numbers[PART * part_b + 1], b.numbers[PART * part_b + 2]
        px, py, pz = _support(a, part_a, work, _POSE_A, -nx, -ny, -nz)
        return bool(nx * px + ny * py + nz * pz - b.numbers[PART * part_b + 3] > margin)
    square, count = vx * vx + vy * vy + vz * vz, 0
    if not square > 1e-20:
        vx, vy, vz, square = 1.0, 0.0, 0.0, 1.0
    for rounds in range(ROUNDS):
        ax, ay, az = _support(a, part_a, work, _POSE_A, -vx, -vy, -vz)
        bx, by, bz = _support(b, part_b, work, _POSE_B, vx, vy, vz)
        wx, wy, wz = ax - bx, ay - by, az - bz
        along = vx * wx + vy * wy + vz * wz
        if along > margin * math.sqrt(square):
            work[AXIS], work[AXIS + 1], work[AXIS + 2] = vx, vy, vz
            return True
        if rounds > 0 and square - along <= 1e-9 * square:
            return False
        for i in range(count):
            if work[3 * i] == wx and work[3 * i + 1] == wy and work[3 * i + 2] == wz:
                return False
        work[3 * count], work[3 * count + 1], work[3 * count + 2] = wx, wy, wz
        count = reduced(work, count + 1)
        vx, vy, vz = work[NEAREST], work[NEAREST + 1], work[NEAREST + 2]
        square = vx * vx + vy * vy + vz * vz
        if count == 4 or square <= margin * margin or square < 1e-16:
            return False
    return False


@lane_part
def _place(parts: Parts, part: int, body: Floats, work: Floats, pose: int) -> None:
    """Write the placement of a part whose body is placed so (12)."""
    if parts.shapes[3 * part] == POLYTOPE:
        for k in range(12):
            work[pose + k] = body[k]
        return
    at = part * PART
    for r in range(3):
        for c in range(4):
            total = body[4 * r + 3] if c == 3 else 0.0
            for k in range(3):
                total += body[4 * r + k] * parts.numbers[at + 4 * k + c]
            work[pose + 4 * r + c] = total


@lane_part
def _place_ball(parts: Parts, node: int, body: Floats, work: Floats, pose: int) -> None:
    """Write the placement of a node's ball: the body's rotation, the ball's centre."""
    x, y, z = parts.balls[4 * node], parts.balls[4 * node + 1], parts.balls[4 * node + 2]
    for r in range(3):
        for c in range(3):
            work[pose + 4 * r + c] = body[4 * r + c]
        work[pose + 4 * r + 3] = body[4 * r] * x + body[4 * r + 1] * y + body[4 * r + 2] * z + body[4 * r + 3]


@lane_part
def _balls_apart(work: Floats, reach: float) -> bool:
    """Whether the origins of the two poses are farther apart than a reach."""
    x = work[_POSE_A + 3] - work[_POSE_B + 3]
    y = work[_POSE_A + 7] - work[_POSE_B + 7]
    z = work[_POSE_A + 11] - work[_POSE_B + 11]
    return bool(x * x + y * y + z * z > reach * reach)


@lane_kernel(boolean(PARTS, types.int64, VECTOR_OUT, PARTS, types.int64, VECTOR_OUT, types.float64, VECTOR_OUT))
def bodies_apart(
    a: Parts, root_a: int, pose_a: Floats, b: Parts, root_b: int, pose_b: Floats, margin: float, work: Floats
) -> bool:
    """Whether two bodies are farther apart than a margin.

    Args:
        a: Tables that the first body is in.
        root_a: Root of its tree of balls.
        pose_a: Its placement, shape (12,), row by row.
        b, root_b, pose_b: The same of the second; only it may be a half-space.
        margin: What they have to keep [m], >= 0.
        work: Scratch, shape (WORK,); the last axis in it is where the search starts, and is left there.
    """
    top = 1
    work[_STACK], work[_STACK + 1] = root_a, root_b
    while top > 0:
        top -= 1
        node_a, node_b = int(work[_STACK + 2 * top]), int(work[_STACK + 2 * top + 1])
        part_a, part_b = a.links[3 * node_a + 2], b.links[3 * node_b + 2]
        radius_a, radius_b = a.balls[4 * node_a + 3], b.balls[4 * node_b + 3]
        bounded = part_b < 0 or b.shapes[3 * part_b] != HALF_SPACE
        if part_a < 0 or part_b < 0:
            _place_ball(a, node_a, pose_a, work, _POSE_A)
            if bounded:
                _place_ball(b, node_b, pose_b, work, _POSE_B)
                if _balls_apart(work, radius_a + radius_b + margin):
                    continue
            if part_b >= 0:  # a's ball against the part itself: a big table's ball says nothing
                _place(b, part_b, pose_b, work, _POSE_B)
                if _apart(a, -1, b, part_b, radius_a + b.numbers[PART * part_b + 15] + margin, work):
                    continue
            elif part_a >= 0:
                _place(a, part_a, pose_a, work, _POSE_A)
                if _apart(a, part_a, b, -1, a.numbers[PART * part_a + 15] + radius_b + margin, work):
                    continue
            split_a = part_a < 0 and (part_b >= 0 or radius_a >= radius_b)
            for side in range(2):
                work[_STACK + 2 * top] = a.links[3 * node_a + side] if split_a else node_a
                work[_STACK + 2 * top + 1] = node_b if split_a else b.links[3 * node_b + side]
                top += 1
            continue
        _place(a, part_a, pose_a, work, _POSE_A)
        _place(b, part_b, pose_b, work, _POSE_B)
        rounding = a.numbers[PART * part_a + 15] + b.numbers[PART * part_b + 15]
        if not _apart(a, part_a, b, part_b, rounding + margin, work):
            return False
    return True
