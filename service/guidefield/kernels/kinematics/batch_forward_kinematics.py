"""Forward kinematics of sixteen configurations at once, in float32, from tables: one kernel for every robot."""

from __future__ import annotations

from typing import NamedTuple

from numba import int64, void

from guidefield.kernels.jit.fields import Indices, Singles, numba_type
from guidefield.kernels.jit.signatures import FLOAT_POINTER, Floats32, lane_part, lane_step
from guidefield.kernels.kinematics.poses import POSE, ROW, moved_row, row_along
from guidefield.kernels.simd.blocks import points_at
from guidefield.kernels.simd.packing import pointed
from guidefield.kernels.simd.rotations import cosine_and_sine, quaternion_of_vector
from guidefield.kernels.simd.vector import LANES, Vector, load, splat, store

TURNING, SLIDING, PLANAR, BALL, FLOATING = range(5)
"""Kinds of joints: about z; along z; along x and y and about z; about a point; all of these. The frame of a joint with
one degree of freedom is turned so that its axis is z; the others take as many coordinates as the chart has."""

PLAIN, SQUARE, PARALLEL, GROUNDED = range(4)
"""Forms of the placement of a joint in its parent's frame: any; turned about x by a right angle, or not at all, of a
turning joint; any in the world, of one that turns or slides."""

MULTIPLIER, OFFSET, QUATERNION, JOINT = 12, 13, 12, 16
"""Numbers of a joint: behind its placement in the parent's frame (12, row by row) multiplier and offset of its value,
or the quaternion (x, y, z, w) that its rotation vector starts from; then how many numbers there are."""


class LaneJoints(NamedTuple):
    """Joints, parents before children; row 0 is the world, which never moves.

    Attributes:
        size: n.
        parents: (n,) index of each joint's parent.
        kinds: (n,) one of the kinds above.
        forms: (n,) one of the forms above; `PLAIN` is always right.
        drivers: (n,) which coordinate moves it, or the first of several; joints that mimic others share one.
        numbers: (n * JOINT,) placements and what follows them: the value of a joint with one degree of freedom is
            multiplier * coordinate + offset.
    """

    size: int
    parents: Indices
    kinds: Indices
    forms: Indices
    drivers: Indices
    numbers: Singles


LANE_JOINTS = numba_type(LaneJoints)
JOINTS = pointed(LANE_JOINTS)


@lane_step(void(FLOAT_POINTER))
def _place_world(poses_out: Floats32) -> None:
    """Write the world's own placement, the identity, into the first place."""
    for entry in range(12):
        store(poses_out, entry * LANES, splat(1.0 if entry in (0, 5, 10) else 0.0))


@lane_part
def _shifted(poses: Floats32, row: int, numbers: Floats32, base: int) -> Vector:
    """A number of the place of a joint whose parent's placement has its row there."""
    return moved_row(poses, row, numbers[base + 3], numbers[base + 7], numbers[base + 11])


@lane_part
def _turned_row(poses: Floats32, row: int, numbers: Floats32, base: int) -> tuple[Vector, Vector, Vector]:
    """A row of the rotation of a joint before it moves, whose parent's placement has its row there."""
    return (
        row_along(poses, row, numbers[base], numbers[base + 4], numbers[base + 8]),
        row_along(poses, row, numbers[base + 1], numbers[base + 5], numbers[base + 9]),
        row_along(poses, row, numbers[base + 2], numbers[base + 6], numbers[base + 10]),
    )


@lane_part
def _write_row(poses_out: Floats32, row: int, r0: Vector, r1: Vector, r2: Vector, t: Vector) -> None:
    """Write a row of placements: of their rotations, and their translation's number."""
    store(poses_out, row, r0)
    store(poses_out, row + LANES, r1)
    store(poses_out, row + 2 * LANES, r2)
    store(poses_out, row + 3 * LANES, t)


@lane_part
def _place_grounded(
    turning: bool, numbers: Floats32, base: int, value: Vector, c: Vector, s: Vector, poses_out: Floats32, here: int
) -> None:
    """Write placements of a joint that turns in the world, by angles with these cosines and sines, or slides in it."""
    for r in range(3):
        row, at = here + r * ROW, base + 4 * r
        n0, n1, n2, t = numbers[at], numbers[at + 1], splat(numbers[at + 2]), numbers[at + 3]
        if turning:
            _write_row(poses_out, row, c * n0 + s * n1, c * n1 - s * n0, n2, splat(t))
        else:
            _write_row(poses_out, row, splat(n0), splat(n1), n2, value * numbers[at + 2] + t)


@lane_part
def _place_square(
    numbers: Floats32, base: int, c: Vector, s: Vector, poses_out: Floats32, here: int, there: int
) -> None:
    """Write placements of a joint whose axis is at right angles to its parent's."""
    for r in range(3):
        row = there + r * ROW
        p0, p1, p2 = points_at(poses_out, row)
        t = _shifted(poses_out, row, numbers, base)
        _write_row(poses_out, here + r * ROW, p0 * c + p2 * s, p2 * c - p0 * s, -p1, t)


@lane_part
def _place_parallel(
    numbers: Floats32, base: int, c: Vector, s: Vector, poses_out: Floats32, here: int, there: int
) -> None:
    """Write placements of a joint whose axis is parallel to its parent's."""
    for r in range(3):
        row = there + r * ROW
        p0, p1, p2 = points_at(poses_out, row)
        t = _shifted(poses_out, row, numbers, base)
        _write_row(poses_out, here + r * ROW, p0 * c + p1 * s, p1 * c - p0 * s, p2, t)


@lane_part
def _place_plain(
    turning: bool,
    numbers: Floats32,
    base: int,
    value: Vector,
    c: Vector,
    s: Vector,
    poses_out: Floats32,
    here: int,
    there: int,
) -> None:
    """Write placements of any joint with one degree of freedom."""
    for r in range(3):
        row = there + r * ROW
        r0, r1, r2 = _turned_row(poses_out, row, numbers, base)
        t = _shifted(poses_out, row, numbers, base)
        _write_row(poses_out, here + r * ROW, r0 * c + r1 * s, r1 * c - r0 * s, r2, t if turning else t + r2 * value)


@lane_part
def _entries(x: Vector, y: Vector, z: Vector, w: Vector) -> tuple[Vector, ...]:
    """The rotation of unit quaternions, row by row."""
    return (
        1.0 - 2.0 * (y * y + z * z),
        2.0 * (x * y - z * w),
        2.0 * (x * z + y * w),
        2.0 * (x * y + z * w),
        1.0 - 2.0 * (x * x + z * z),
        2.0 * (y * z - x * w),
        2.0 * (x * z - y * w),
        2.0 * (y * z + x * w),
        1.0 - 2.0 * (x * x + y * y),
    )


@lane_part
def _turned(numbers: Floats32, base: int, coordinates: Floats32, at: int) -> tuple[Vector, ...]:
    """Rotation, row by row, of a joint that turns about a point: that it starts from, then its rotation vector's."""
    vx, vy, vz = points_at(coordinates, at)
    ex, ey, ez, ew = quaternion_of_vector(vx, vy, vz)
    first = base + QUATERNION
    x, y, z, w = numbers[first], numbers[first + 1], numbers[first + 2], numbers[first + 3]
    return _entries(
        ex * w + ew * x + ez * y - ey * z,
        ey * w - ez * x + ew * y + ex * z,
        ez * w + ey * x - ex * y + ew * z,
        ew * w - ex * x - ey * y - ez * z,
    )


@lane_step(void(JOINTS, int64, FLOAT_POINTER, FLOAT_POINTER))
def _place_free(joints: LaneJoints, i: int, coordinates: Floats32, poses_out: Floats32) -> None:
    """Write the placement of a joint with several degrees of freedom, whose parent's is there."""
    numbers, base, at = joints.numbers, i * JOINT, joints.drivers[i] * LANES
    here, there, kind = i * POSE, joints.parents[i] * POSE, joints.kinds[i]
    x, y, z = splat(0.0), splat(0.0), splat(0.0)
    if kind != BALL:
        x, y = load(coordinates, at), load(coordinates, at + LANES)
    if kind == FLOATING:
        z = load(coordinates, at + 2 * LANES)
        at += 3 * LANES
    a, b, c, d, e, f, g, h, k = _entries(splat(0.0), splat(0.0), splat(0.0), splat(1.0))
    if kind == PLANAR:
        a, d = cosine_and_sine(load(coordinates, at + 2 * LANES))
        b, e = -d, a
    else:
        a, b, c, d, e, f, g, h, k = _turned(numbers, base, coordinates, at)
    for r in range(3):
        row = there + r * ROW
        r0, r1, r2 = _turned_row(poses_out, row, numbers, base)
        t = _shifted(poses_out, row, numbers, base) + r0 * x + r1 * y + r2 * z
        p0, p1, p2 = r0 * a + r1 * d + r2 * g, r0 * b + r1 * e + r2 * h, r0 * c + r1 * f + r2 * k
        _write_row(poses_out, here + r * ROW, p0, p1, p2, t)


@lane_step(void(JOINTS, FLOAT_POINTER, FLOAT_POINTER))
def lane_placements(joints: LaneJoints, coordinates: Floats32, poses_out: Floats32) -> None:
    """World placements of all joints' moved frames at sixteen configurations.

    Args:
        joints: The joints.
        coordinates: Sixteen values of each coordinate, shape (nv * 16,) [rad or m]; rotation vectors are shorter than a
            full turn.
        poses_out: Entry by entry of rotation and translation [m], shape (n * POSE,); all 0, or from an earlier call,
            as the world stays where it is.
    """
    size, parents, kinds, forms, drivers, numbers = joints
    if poses_out[0] != 1.0:
        _place_world(poses_out)
    for i in range(1, size):
        base, here, there, form = i * JOINT, i * POSE, parents[i] * POSE, forms[i]
        value = load(coordinates, drivers[i] * LANES) * numbers[base + MULTIPLIER] + numbers[base + OFFSET]
        turning = kinds[i] == TURNING
        c, s = splat(1.0), splat(0.0)
        if turning:
            c, s = cosine_and_sine(value)
        if form == SQUARE:
            _place_square(numbers, base, c, s, poses_out, here, there)
        elif form == PARALLEL:
            _place_parallel(numbers, base, c, s, poses_out, here, there)
        elif form == GROUNDED:
            _place_grounded(turning, numbers, base, value, c, s, poses_out, here)
        elif kinds[i] > SLIDING:
            _place_free(joints, i, coordinates, poses_out)
        else:
            _place_plain(turning, numbers, base, value, c, s, poses_out, here, there)
