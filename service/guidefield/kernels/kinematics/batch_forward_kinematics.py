"""Forward kinematics of sixteen configurations at once, in float32, from tables: one kernel for every robot.

`collision/batch/robot_tables.py` writes the tables: kinds, forms and columns have to be the same there. Numbers are off
by less than `DECISION_BAND` of `kernels/collide/layout.py`; collision tests rely on that.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from numba import int64, void

from guidefield.kernels.jit.arrays import FLOAT_POINTER, Floats32, Indices, Singles, numba_type
from guidefield.kernels.jit.decorators import vector_part, vector_step
from guidefield.kernels.kinematics.poses import POSE, ROW, moved_row
from guidefield.kernels.simd.packing import pointed, points_at
from guidefield.kernels.simd.rotations import cosine_and_sine, quaternion_of_vector
from guidefield.kernels.simd.vector import LANES, Vector, load, splat, store

TURNING, SLIDING, PLANAR, BALL, FLOATING = range(5)
"""Kinds of joints: about z; along z; along x and y and about z; about a point; all of these. The frame of a joint with
one degree of freedom is turned so that its axis is z; the others take as many local coordinates as they have."""

PLAIN, SQUARE, PARALLEL, GROUNDED = range(4)
"""Forms of the placement of a joint in its parent's frame: any; turned about x by a right angle, or not at all, of a
turning joint; any in the world, of one that turns or slides."""

MULTIPLIER, OFFSET, QUATERNION, JOINT = 12, 13, 12, 16
"""Numbers of a joint: behind its placement in the parent's frame (12, row by row) multiplier and offset of its value,
or the quaternion (x, y, z, w) that its rotation vector starts from; then how many numbers there are."""


class BatchJoints(NamedTuple):
    """Joints, parents before children; row 0 is the world, which never moves."""

    size: int  # n
    parents: Indices  # (n,) index of each joint's parent
    kinds: Indices  # (n,) one of the kinds above
    forms: Indices  # (n,) one of the forms above; `PLAIN` is always right
    sources: Indices  # (n,) the coordinate that moves it, or the first of several; that of a mimic joint's source
    # (n * JOINT,) placements and what follows them: the value of a joint with one degree of freedom is multiplier *
    # coordinate + offset
    numbers: Singles


BATCH_JOINTS = numba_type(BatchJoints)
JOINTS = pointed(BATCH_JOINTS)


@vector_step(void(FLOAT_POINTER))
def _place_world(poses_out: Floats32) -> None:
    for entry in range(12):
        store(poses_out, entry * LANES, splat(1.0 if entry in (0, 5, 10) else 0.0))


@vector_part
def row_after(a: Any, b: Any, c: Any, t: Any, fixed: Any, at: int) -> tuple[Any, Any, Any, Any]:
    """A row of placements, rotation and translation, with a fixed placement after them, whose numbers begin there."""
    return (
        a * fixed[at] + b * fixed[at + 4] + c * fixed[at + 8],
        a * fixed[at + 1] + b * fixed[at + 5] + c * fixed[at + 9],
        a * fixed[at + 2] + b * fixed[at + 6] + c * fixed[at + 10],
        a * fixed[at + 3] + b * fixed[at + 7] + c * fixed[at + 11] + t,
    )


@vector_part
def row_turned(a: Any, b: Any, c: Any, s: Any) -> tuple[Any, Any]:
    """The first two numbers of a row of rotations turned about z, by cosine and sine."""
    return a * c + b * s, b * c - a * s


@vector_part
def row_times(a: Any, b: Any, c: Any, R: Any) -> tuple[Any, Any, Any]:
    """A row of rotations times rotations, which are given row by row."""
    return a * R[0] + b * R[3] + c * R[6], a * R[1] + b * R[4] + c * R[7], a * R[2] + b * R[5] + c * R[8]


@vector_part
def _row_at(poses: Floats32, row: int, numbers: Floats32, base: int) -> tuple[Vector, Vector, Vector, Vector]:
    """The row of a joint's placements before it moves, whose parent's has its row there."""
    p0, p1, p2 = points_at(poses, row)
    return row_after(p0, p1, p2, load(poses, row + 3 * LANES), numbers, base)


@vector_part
def _write_row(poses_out: Floats32, row: int, r0: Vector, r1: Vector, r2: Vector, t: Vector) -> None:
    """Write a row of placements: of their rotations, and their translation's number."""
    store(poses_out, row, r0)
    store(poses_out, row + LANES, r1)
    store(poses_out, row + 2 * LANES, r2)
    store(poses_out, row + 3 * LANES, t)


@vector_part
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


@vector_part
def _place_square(
    numbers: Floats32, base: int, c: Vector, s: Vector, poses_out: Floats32, here: int, there: int
) -> None:
    """Write placements of a joint whose axis is at right angles to its parent's."""
    for r in range(3):
        row = there + r * ROW
        p0, p1, p2 = points_at(poses_out, row)
        t = moved_row(poses_out, row, numbers[base + 3], numbers[base + 7], numbers[base + 11])
        along, across = row_turned(p0, p2, c, s)
        _write_row(poses_out, here + r * ROW, along, across, -p1, t)


@vector_part
def _place_parallel(
    numbers: Floats32, base: int, c: Vector, s: Vector, poses_out: Floats32, here: int, there: int
) -> None:
    """Write placements of a joint whose axis is parallel to its parent's."""
    for r in range(3):
        row = there + r * ROW
        p0, p1, p2 = points_at(poses_out, row)
        t = moved_row(poses_out, row, numbers[base + 3], numbers[base + 7], numbers[base + 11])
        along, across = row_turned(p0, p1, c, s)
        _write_row(poses_out, here + r * ROW, along, across, p2, t)


@vector_part
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
        r0, r1, r2, t = _row_at(poses_out, there + r * ROW, numbers, base)
        along, across = row_turned(r0, r1, c, s)
        _write_row(poses_out, here + r * ROW, along, across, r2, t if turning else t + r2 * value)


@vector_part
def rotation_of(x: Any, y: Any, z: Any, w: Any) -> tuple[Vector, ...]:
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


@vector_part
def _turn(numbers: Floats32, base: int, coordinates: Floats32, at: int) -> tuple[Vector, ...]:
    """Rotation, row by row, of a joint that turns about a point: that it starts from, then its rotation vector's."""
    vx, vy, vz = points_at(coordinates, at)
    ex, ey, ez, ew = quaternion_of_vector(vx, vy, vz)
    first = base + QUATERNION
    x, y, z, w = numbers[first], numbers[first + 1], numbers[first + 2], numbers[first + 3]
    return rotation_of(
        ex * w + ew * x + ez * y - ey * z,
        ey * w - ez * x + ew * y + ex * z,
        ez * w + ey * x - ex * y + ew * z,
        ew * w - ex * x - ey * y - ez * z,
    )


@vector_step(void(JOINTS, int64, FLOAT_POINTER, FLOAT_POINTER))
def _place_free(joints: BatchJoints, i: int, coordinates: Floats32, poses_out: Floats32) -> None:
    """Write the placement of a joint with several degrees of freedom, whose parent's is there."""
    numbers, base, at = joints.numbers, i * JOINT, joints.sources[i] * LANES
    here, there, kind = i * POSE, joints.parents[i] * POSE, joints.kinds[i]
    x, y, z = splat(0.0), splat(0.0), splat(0.0)
    if kind != BALL:
        x, y = load(coordinates, at), load(coordinates, at + LANES)
    if kind == FLOATING:
        z = load(coordinates, at + 2 * LANES)
        at += 3 * LANES
    if kind == PLANAR:
        cosine, sine = cosine_and_sine(load(coordinates, at + 2 * LANES))
        none, one = splat(0.0), splat(1.0)
        R = (cosine, -sine, none, sine, cosine, none, none, none, one)
    else:
        R = _turn(numbers, base, coordinates, at)
    for r in range(3):
        r0, r1, r2, t = _row_at(poses_out, there + r * ROW, numbers, base)
        p0, p1, p2 = row_times(r0, r1, r2, R)
        _write_row(poses_out, here + r * ROW, p0, p1, p2, t + r0 * x + r1 * y + r2 * z)


@vector_step(void(JOINTS, FLOAT_POINTER, FLOAT_POINTER))
def batch_placements(joints: BatchJoints, coordinates: Floats32, poses_out: Floats32) -> None:
    """Write world placements (n * POSE,) of all joints at sixteen configurations, `coordinates` (nv * 16,) [rad or m].

    Rotation vectors are shorter than a full turn; `poses_out` is all 0 or of an earlier call, as the world stays.
    """
    size, parents, kinds, forms, sources, numbers = joints
    if poses_out[0] != 1.0:
        _place_world(poses_out)
    for i in range(1, size):
        base, here, there, form = i * JOINT, i * POSE, parents[i] * POSE, forms[i]
        value = load(coordinates, sources[i] * LANES) * numbers[base + MULTIPLIER] + numbers[base + OFFSET]
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
