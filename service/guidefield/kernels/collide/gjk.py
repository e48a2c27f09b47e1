"""Distance of two bodies made of convex parts, or if it exceeds a margin: GJK in float64 over trees of balls.

GJK after Gilbert, Johnson and Keerthi (1988). With v the point of the simplex in the difference A - B nearest to the
origin and w the support point of A - B against v, the distance is at least v.w / |v| and at most |v|: the search ends
when these differ by less than `ACCURACY`, or where one of them says enough. Of two trees the nearer children are
compared first. Batches of collision tests and proofs call it: distances may be too large by `ACCURACY`, smallest ones
by `SLACK` as well.

Scratch is one array of `WORK` numbers: the simplex, two poses, the axis, the nearest leaves, then the stack. A simplex
is up to four points of `POINT` numbers each. A reduction keeps the points that span the nearest point, moves them to
the front, writes the nearest point behind the fourth (`NEAREST`), and returns how many were kept; four means that the
origin is inside. Voronoi regions are as in Ericson, Real-Time Collision Detection, 2005.
"""

from __future__ import annotations

import math

import numpy as np
from numba import boolean, int64, types

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
    X,
    Y,
    Z,
    ball_radius,
    child_of,
    is_flat_sided,
    is_leaf,
    kind_of,
    part_of,
    place_ball,
    place_part,
    place_part_of,
    rounding,
)
from guidefield.kernels.collide.primitive import CYLINDER, HALF_SPACE
from guidefield.kernels.jit.arrays import DOUBLE_POINTER, Floats, Floats32, Integers
from guidefield.kernels.jit.decorators import vector_part, vector_step
from guidefield.kernels.linalg.small_systems import unit_in_plane
from guidefield.kernels.simd.packing import BLOCK, point_at, points_at
from guidefield.kernels.simd.vector import ALL_LANES, below, first_lane, lane, largest_lane, select, splat

POINT = 3  # numbers of a point
NEAREST = 4 * POINT  # place of the nearest point in the array

POSE_A, POSE_B = 16, 28  # places of the two poses of the parts that are compared

AXIS, KEPT = 40, 44
"""Place of the last separating axis, all 0 where there is none, and of another one to keep, with a reach behind it."""

LEAF_A, LEAF_B = 48, 49  # places of the leaves of two bodies that were nearest to each other last, each plus 1, or 0
STACK, WORK = 64, 512  # place of the stack, and the number of all numbers: room for the levels of two trees, unchecked

ACCURACY = 2e-7  # by how much a distance may be too large [m], below `layout.DECISION_BAND`; see `SLACK`

ROUNDS, FEW_ROUNDS = 64, 5
"""Rounds after which GJK ends with what it has (among rounded parts it comes closer by a factor each time), and rounds
for two nodes that aren't both leaves, where a bound is enough: these, at least 1, change time, and distances within
`SLACK`, while fewer `ROUNDS` would leave distances that are too large by more than `ACCURACY`."""

SLACK = 5e-6
"""Leaves nearer than the nearest known ones by no more than this aren't searched: flat sides have many alike [m].
Certificates and `prove/closest.py` allow for it and `ACCURACY`; `prove/tables.NEARLY` is above their sum."""

PLACED = (POINTED_PARTS, int64, DOUBLE_POINTER)  # tables, a node or part in them, the placement of its body

NODE_A, NODE_B, LEAST, ENTRY = range(4)
"""Numbers of an entry of the stack: a node of each body, and how far apart what they hold is at least [m]; then how
many there are."""


@vector_part
def _nearest_point(w: Floats) -> tuple[float, float, float]:
    return w[NEAREST], w[NEAREST + 1], w[NEAREST + 2]


@vector_part
def _has_point(w: Floats, count: int, x: float, y: float, z: float) -> bool:
    found = False
    for at in range(0, count * POINT, POINT):
        found |= w[at] == x and w[at + 1] == y and w[at + 2] == z
    return found


@vector_part
def _dot(w: Floats, i: int, j: int) -> float:
    return float(w[i] * w[j] + w[i + 1] * w[j + 1] + w[i + 2] * w[j + 2])


@vector_part
def _copy(w: Floats, source: int, target: int) -> None:
    for k in range(POINT):
        w[target + k] = w[source + k]


@vector_part
def _mix(w: Floats, a: int, b: int, c: int, s: float, t: float) -> None:
    """Write a + s (b - a) + t (c - a) as the nearest point."""
    for k in range(POINT):
        base = w[a + k]
        w[NEAREST + k] = base + s * (w[b + k] - base) + t * (w[c + k] - base)


@vector_part
def _on_segment(w: Floats, a: int, b: int) -> int:
    """Nearest point of a segment; which of (a, b) span it, as bits."""
    ab = _dot(w, a, b) - _dot(w, a, a)
    bb = _dot(w, b, b) - _dot(w, a, b)
    length = bb - ab
    if -ab <= 0.0 or length <= 0.0:
        _copy(w, a, NEAREST)
        return 1
    if bb <= 0.0:
        _copy(w, b, NEAREST)
        return 2
    _mix(w, a, b, a, -ab / length, 0.0)
    return 3


@vector_step(int64(DOUBLE_POINTER, int64, int64, int64))
def _on_triangle(w: Floats, a: int, b: int, c: int) -> int:  # noqa: PLR0911  one for each region of the plane
    """Nearest point of a triangle; which of (a, b, c) span it, as bits."""
    aa, bb, cc = _dot(w, a, a), _dot(w, b, b), _dot(w, c, c)
    ab, ac, bc = _dot(w, a, b), _dot(w, a, c), _dot(w, b, c)
    d1, d2 = aa - ab, aa - ac
    d3, d4 = ab - bb, ab - bc
    d5, d6 = ac - bc, ac - cc
    if d1 <= 0.0 and d2 <= 0.0:
        _copy(w, a, NEAREST)
        return 1
    if d3 >= 0.0 and d4 <= d3:
        _copy(w, b, NEAREST)
        return 2
    if d6 >= 0.0 and d5 <= d6:
        _copy(w, c, NEAREST)
        return 4
    vc, vb, va = d1 * d4 - d3 * d2, d5 * d2 - d1 * d6, d3 * d6 - d5 * d4
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        _mix(w, a, b, c, d1 / max(d1 - d3, 1e-300), 0.0)
        return 3
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        _mix(w, a, b, c, 0.0, d2 / max(d2 - d6, 1e-300))
        return 5
    if va <= 0.0 and d4 >= d3 and d5 >= d6:
        t = (d4 - d3) / max((d4 - d3) + (d5 - d6), 1e-300)
        _mix(w, a, b, c, 1.0 - t, t)
        return 6
    total = max(va + vb + vc, 1e-300)
    _mix(w, a, b, c, vb / total, vc / total)
    return 7


@vector_step(boolean(DOUBLE_POINTER, int64, int64, int64, int64))
def _outside(w: Floats, a: int, b: int, c: int, d: int) -> bool:
    """Tell if the plane through (a, b, c) has the origin and d on different sides, or either on it."""
    ax, ay, az = w[a], w[a + 1], w[a + 2]
    ux, uy, uz = w[b] - ax, w[b + 1] - ay, w[b + 2] - az
    vx, vy, vz = w[c] - ax, w[c + 1] - ay, w[c + 2] - az
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    origin = -(nx * ax + ny * ay + nz * az)
    other = nx * (w[d] - ax) + ny * (w[d + 1] - ay) + nz * (w[d + 2] - az)
    return bool(origin * other <= 0.0)


@vector_part
def _on_tetrahedron(w: Floats) -> int:
    """Nearest point of a tetrahedron; which of its four points span it, as bits."""
    best, kept = 1e300, 15
    bx, by, bz = 0.0, 0.0, 0.0
    for face in range(4):
        # the face without point 3 - face
        a = 0 if face < 3 else POINT
        b = POINT if face < 2 else 2 * POINT
        c = 2 * POINT if face == 0 else 3 * POINT
        d = (3 - face) * POINT
        if not _outside(w, a, b, c, d):
            continue
        bits = _on_triangle(w, a, b, c)
        square = _dot(w, NEAREST, NEAREST)
        if square < best:
            best = square
            bx, by, bz = _nearest_point(w)
            kept = (bits & 1) << (a // POINT)
            kept |= ((bits >> 1) & 1) << (b // POINT)
            kept |= ((bits >> 2) & 1) << (c // POINT)
    w[NEAREST], w[NEAREST + 1], w[NEAREST + 2] = bx, by, bz
    return kept


@vector_step(int64(DOUBLE_POINTER, int64))
def _reduce(w: Floats, count: int) -> int:
    """Reduce a simplex of `count` points; how many are left."""
    bits = 1
    if count == 1:
        _copy(w, 0, NEAREST)
    elif count == 2:
        bits = _on_segment(w, 0, POINT)
    elif count == 3:
        bits = _on_triangle(w, 0, POINT, 2 * POINT)
    else:
        bits = _on_tetrahedron(w)
    kept = 0
    for i in range(count):
        if (bits >> i) & 1:
            if kept != i:
                _copy(w, POINT * i, POINT * kept)
            kept += 1
    return kept


@vector_part
def axis_in(work: Floats) -> tuple[float, float, float]:
    """The last separating axis in the scratch space, shape (WORK,); all 0 if there is none."""
    return work[AXIS], work[AXIS + 1], work[AXIS + 2]


@vector_part
def axis_length(work: Floats) -> float:
    """Length of the axis in the scratch space, shape (WORK,)."""
    return math.sqrt(work[AXIS] ** 2 + work[AXIS + 1] ** 2 + work[AXIS + 2] ** 2)


@vector_part
def write_axis(work: Floats, x: float, y: float, z: float) -> None:
    """Write the axis that the next search in the scratch space, shape (WORK,), begins with."""
    work[AXIS], work[AXIS + 1], work[AXIS + 2] = x, y, z


@vector_part
def divide_axis(work: Floats, length: float) -> None:
    """Divide the axis in the scratch space, shape (WORK,), by a length."""
    for k in range(AXIS, AXIS + 3):
        work[k] /= length


@vector_part
def origins_apart(work: Floats) -> float:
    """Return how far apart the origins of the two poses in the scratch space, shape (WORK,), are, squared [m^2]."""
    x = work[POSE_A + X] - work[POSE_B + X]
    y = work[POSE_A + Y] - work[POSE_B + Y]
    z = work[POSE_A + Z] - work[POSE_B + Z]
    return float(x * x + y * y + z * z)


@vector_part
def _farthest_vertex(
    vertices: Floats32, first: int, blocks: int, x: float, y: float, z: float
) -> tuple[float, float, float]:
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


@vector_part
def _farthest_corner(numbers: Floats, at: int, x: float, y: float, z: float) -> int:
    """Place of the triangle's corner farthest along a direction: 0, 3 or 6."""
    farthest, best = 0, numbers[at] * x + numbers[at + 1] * y + numbers[at + 2] * z
    for corner in (3, 6):
        along = numbers[at + corner] * x + numbers[at + corner + 1] * y + numbers[at + corner + 2] * z
        if along > best:
            farthest, best = corner, along
    return farthest


@vector_part
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
    """Return the point of a part, without what rounds it, farthest along a direction, in the world.

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


@vector_part
def over_plane(a: Parts, part_a: int, b: Parts, part_b: int, work: Floats) -> float:
    """Return how far a part, without what rounds it, is over a half-space's plane [m]; the normal becomes the axis.

    The pose that places the part stands in the scratch space, shape (WORK,).
    """
    at = PART * part_b
    nx, ny, nz = b.numbers[at], b.numbers[at + 1], b.numbers[at + 2]
    px, py, pz = support(a.shapes, a.numbers, a.vertices, part_a, work, POSE_A, -nx, -ny, -nz)
    write_axis(work, nx, ny, nz)
    return float(nx * px + ny * py + nz * pz - b.numbers[at + PLANE_OFFSET])


@vector_step(types.float64(*(POINTED_PARTS, int64) * 2, *(types.float64,) * 3, int64, DOUBLE_POINTER))
def parts_distance(
    a: Parts, part_a: int, b: Parts, part_b: int, rounding: float, least: float, most: float, rounds: int, work: Floats
) -> float:
    """Return the distance of two parts that the poses in scratch (WORK,) place, less what rounds them [m].

    A part is -1 for a point at the origin of its pose; only the second may be a half-space. Some bound of the distance
    is enough that is no more than `least` [m], minus infinity: none, or no less than `most` [m]. Fewer than `ROUNDS`
    rounds give a bound of the distance. The search begins with the axis in the scratch, and leaves its last one.

    The distance is at most `ACCURACY` too large, or if a least one is given too small; not above -rounding where the
    parts overlap without what rounds them.
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
        if _has_point(work, count, wx, wy, wz):
            break
        at = POINT * count
        work[at], work[at + 1], work[at + 2] = wx, wy, wz
        count = int(_reduce(work, count + 1))
        vx, vy, vz = _nearest_point(work)
        square = vx * vx + vy * vy + vz * vz
        if count == 4 or square < 1e-16:
            if lower <= ACCURACY:
                return -rounding
            # an axis separates them: of a simplex so flat rounding says where the origin is; another is begun
            count, vx, vy, vz = 0, wx, wy, wz
            square = wx * wx + wy * wy + wz * wz
        if square <= near * abs(near):
            write_axis(work, vx, vy, vz)
            return lower - rounding
        if done == rounds - 1 and rounds < ROUNDS:
            write_axis(work, vx, vy, vz)
            return lower - rounding
    write_axis(work, vx, vy, vz)
    return (lower if least > -np.inf else math.sqrt(square)) - rounding


@vector_step(types.float64(POINTED_PARTS, int64, DOUBLE_POINTER, types.float64, types.float64, types.float64))
def reach_along(parts: Parts, part: int, work: Floats, dx: float, dy: float, dz: float) -> float:
    """Return how far a part of a body at the origin reaches along a unit direction in its frame [m]; work (WORK,)."""
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


@vector_part
def _size(parts: Parts, node: int) -> float:
    """Size of a node for dividing [m]: the radius of its ball, times the blocks of vertices of its hull."""
    part = part_of(parts, node)
    blocks = parts.shapes[SHAPE * part + BLOCKS] if part >= 0 else 0
    return float(ball_radius(parts.balls, node) * (1 + blocks))


@vector_part
def divides_first(a: Parts, node_a: int, b: Parts, node_b: int) -> bool:
    """Tell if of two nodes, not both leaves, the first is the one to divide: one that is but a ball before a hull.

    A ball tells little: what is in it is much thinner. With the larger one first a UR5's own pairs need 221 nodes, not
    78, without the blocks of vertices 90. The order also changes distances within `SLACK`, and segments of proofs.
    """
    if is_leaf(a, node_a) or is_leaf(b, node_b):
        return is_leaf(b, node_b)
    is_ball_a, is_ball_b = part_of(a, node_a) < 0, part_of(b, node_b) < 0
    return is_ball_a if is_ball_a != is_ball_b else _size(a, node_a) >= _size(b, node_b)


@vector_step(types.float64(*PLACED, *PLACED, types.float64, types.float64, DOUBLE_POINTER))
def _apart_at_least(
    a: Parts, node_a: int, pose_a: Floats, b: Parts, node_b: int, pose_b: Floats, least: float, most: float,
    work: Floats,
) -> float:  # fmt: skip
    """Bound the distance of two nodes' contents from below [m]; of two leaves as `parts_distance`."""
    part_a, part_b = part_of(a, node_a), part_of(b, node_b)
    radius_a, radius_b = ball_radius(a.balls, node_a), ball_radius(b.balls, node_b)
    place_ball(a, node_a, pose_a, work, POSE_A)
    place_ball(b, node_b, pose_b, work, POSE_B)
    apart = -math.inf
    if radius_b < math.inf:
        apart = math.sqrt(origins_apart(work)) - float(radius_a + radius_b)
        if apart >= most or (part_a < 0 and part_b < 0):
            return apart
    radii = place_part_of(a, node_a, pose_a, work, POSE_A) + place_part_of(b, node_b, pose_b, work, POSE_B)
    rounds = ROUNDS if is_leaf(a, node_a) and is_leaf(b, node_b) else FEW_ROUNDS
    return max(apart, parts_distance(a, part_a, b, part_b, radii, least, most, rounds, work))


@vector_step(types.float64(*PLACED, *PLACED, types.float64, types.float64, types.float64, DOUBLE_POINTER))
def _bodies_distance(
    a: Parts, root_a: int, pose_a: Floats, b: Parts, root_b: int, pose_b: Floats, least: float, most: float,
    slack: float, work: Floats,
) -> float:  # fmt: skip
    """Return the distance of two bodies [m]; not above 0 where they touch.

    Roots are those of trees of balls, poses (12,) place the bodies; only the second may be a half-space. If they are no
    farther apart than `least`, or touch, it is enough to know that; minus infinity: none [m]. If they are farther apart
    than `most`, some bound no less than it is enough [m]. It may be too large by `slack`, besides `ACCURACY` [m]. The
    search begins with the axis and the nearest leaves in `work` (WORK,), and leaves its last ones.
    """
    best, top = most, STACK + ENTRY
    work[STACK + NODE_A], work[STACK + NODE_B], work[STACK + LEAST] = root_a, root_b, -math.inf
    if work[LEAF_A] > 0.0:
        node_a, node_b = int(work[LEAF_A]) - 1, int(work[LEAF_B]) - 1
        best = min(best, _apart_at_least(a, node_a, pose_a, b, node_b, pose_b, least, best, work))
        if best <= 0.0 or (node_a == root_a and node_b == root_b):
            return best
    first = True
    while top > STACK:
        top -= ENTRY
        node_a, node_b = int(work[top + NODE_A]), int(work[top + NODE_B])
        if work[top + LEAST] >= best - slack:
            continue
        leaves = is_leaf(a, node_a) and is_leaf(b, node_b)
        if first or leaves:
            first = False
            apart = _apart_at_least(a, node_a, pose_a, b, node_b, pose_b, least, best, work)
            if apart >= best - (0.0 if leaves else slack):
                continue
            if leaves:
                best = apart
                work[LEAF_A], work[LEAF_B] = node_a + 1, node_b + 1
                if best <= max(least, 0.0):
                    return best
                continue
        split_a, left, right = divides_first(a, node_a, b, node_b), top, top + ENTRY
        for side in (LEFT, RIGHT):
            child_a = child_of(a, node_a, side) if split_a else node_a
            child_b = node_b if split_a else child_of(b, node_b, side)
            at, apart = left if side == LEFT else right, -math.inf
            # what two leaves keep is found when it is their turn: the other child may have come closer by then
            if not (is_leaf(a, child_a) and is_leaf(b, child_b)):
                apart = _apart_at_least(a, child_a, pose_a, b, child_b, pose_b, least, best, work)
            work[at + NODE_A], work[at + NODE_B], work[at + LEAST] = child_a, child_b, apart
        if work[left + LEAST] < work[right + LEAST]:  # the nearer child on top
            for k in range(ENTRY):
                work[left + k], work[right + k] = work[right + k], work[left + k]
        top = right + ENTRY
    return best


@vector_part
def bodies_distance(
    a: Parts, root_a: int, pose_a: Floats, b: Parts, root_b: int, pose_b: Floats, most: float, work: Floats
) -> float:
    """Distance of two bodies, at most `SLACK` and `ACCURACY` too large [m]; the rest as for `_bodies_distance`."""
    return float(_bodies_distance(a, root_a, pose_a, b, root_b, pose_b, -math.inf, most, SLACK, work))


@vector_step(boolean(*PLACED, *PLACED, types.float64, DOUBLE_POINTER))
def bodies_apart(
    a: Parts, root_a: int, pose_a: Floats, b: Parts, root_b: int, pose_b: Floats, margin: float, work: Floats
) -> bool:
    """Tell if two bodies are farther apart than a margin, at least 0 [m]; the rest as for `_bodies_distance`."""
    work[LEAF_A] = 0.0
    return bool(_bodies_distance(a, root_a, pose_a, b, root_b, pose_b, margin, margin, 0.0, work) >= margin)


@vector_step(boolean(*PLACED, *PLACED, types.float64, DOUBLE_POINTER))
def parts_apart(
    a: Parts, part_a: int, pose_a: Floats, b: Parts, part_b: int, pose_b: Floats, margin: float, work: Floats
) -> bool:
    """`bodies_apart` for two parts; same shapes."""
    place_part(a, part_a, pose_a, work, POSE_A)
    place_part(b, part_b, pose_b, work, POSE_B)
    radii = rounding(a, part_a) + rounding(b, part_b)
    return bool(parts_distance(a, part_a, b, part_b, radii, margin, margin, ROUNDS, work) >= margin)
