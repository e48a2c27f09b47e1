"""A pose times a point or an axis, and back, in the three ways that kernels hold poses.

A *placement* is a matrix (3, 4), rotation and translation; a *pose* the same twelve numbers flat, row by row; *poses*
are those of sixteen configurations in lanes, joint by joint. Lengths in m. Another order of sums may change last bits.
"""

from __future__ import annotations

from typing import Any

from guidefield.kernels.jit.arrays import Floats, Floats32, Vector3
from guidefield.kernels.jit.decorators import inlined, vector_part
from guidefield.kernels.simd.vector import LANES, Vector, load

POSE = 12 * LANES  # floats of sixteen poses: each of the twelve numbers in sixteen lanes
ROW = 4 * LANES  # floats from a row of these to the next


@inlined
def moved_by(T: Floats, x: float, y: float, z: float) -> Vector3:
    """Return where a point of a placed frame is, by its placement, shape (3, 4) [m]."""
    return (
        T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3],
        T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3],
        T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3],
    )


@inlined
def turned_by(T: Floats, x: float, y: float, z: float) -> Vector3:
    """An axis of a placed frame, by its placement, shape (3, 4)."""
    return (
        T[0, 0] * x + T[0, 1] * y + T[0, 2] * z,
        T[1, 0] * x + T[1, 1] * y + T[1, 2] * z,
        T[2, 0] * x + T[2, 1] * y + T[2, 2] * z,
    )


@inlined
def moved_back_by(T: Floats, x: float, y: float, z: float) -> Vector3:
    """A point in a placed frame, by the frame's placement, shape (3, 4) [m]."""
    dx, dy, dz = x - T[0, 3], y - T[1, 3], z - T[2, 3]
    return (
        T[0, 0] * dx + T[1, 0] * dy + T[2, 0] * dz,
        T[0, 1] * dx + T[1, 1] * dy + T[2, 1] * dz,
        T[0, 2] * dx + T[1, 2] * dy + T[2, 2] * dz,
    )


@vector_part
def apply_pose(pose: Floats, x: Any, y: Any, z: Any) -> tuple[Any, Any, Any]:
    """Return where a pose (12,) has a point, or sixteen of them [m]."""
    return (
        x * pose[0] + y * pose[1] + z * pose[2] + pose[3],
        x * pose[4] + y * pose[5] + z * pose[6] + pose[7],
        x * pose[8] + y * pose[9] + z * pose[10] + pose[11],
    )


@vector_part
def write_turned(pose: Floats, source: Floats, start: int, target: Floats, at: int) -> None:
    """Write rotation of a pose (12,) times three numbers of `source` (n,) to `target` (m,), from an index on each."""
    x, y, z = source[start], source[start + 1], source[start + 2]
    for r in range(3):
        target[at + r] = pose[4 * r] * x + pose[4 * r + 1] * y + pose[4 * r + 2] * z


@vector_part
def write_product(pose: Floats, frames: Floats, start: int, target: Floats, at: int) -> None:
    """Write the pose of a frame, twelve numbers of `frames` (n,), in one with a pose (12,), to `target` (m,)."""
    for r in range(3):
        for c in range(4):
            total = pose[4 * r + 3] if c == 3 else 0.0
            for k in range(3):
                total += pose[4 * r + k] * frames[start + 4 * k + c]
            target[at + 4 * r + c] = total


@vector_part
def turned_back(pose: Floats, x: float, y: float, z: float) -> tuple[float, float, float]:
    """The inverse rotation of a pose (12,) times three numbers."""
    return (
        pose[0] * x + pose[4] * y + pose[8] * z,
        pose[1] * x + pose[5] * y + pose[9] * z,
        pose[2] * x + pose[6] * y + pose[10] * z,
    )


@vector_part
def write_identity(pose_out: Floats) -> None:
    """Write the pose (12,) that leaves everything where it is."""
    for entry in range(12):
        pose_out[entry] = 1.0 if entry in (0, 5, 10) else 0.0


@vector_part
def one_pose(poses: Floats32, joint: int, chosen: int, pose_out: Floats) -> None:
    """Write a joint's pose (12,) in one lane of `poses` (joints * POSE,)."""
    for entry in range(12):
        pose_out[entry] = poses[joint * POSE + entry * LANES + chosen]


@vector_part
def row_along(poses: Floats32, row: int, x: Any, y: Any, z: Any) -> Vector:
    """A row of rotations, which begins there in `poses` (joints * POSE,), times three numbers, or vectors of them."""
    return load(poses, row) * x + load(poses, row + LANES) * y + load(poses, row + 2 * LANES) * z


@vector_part
def moved_row(poses: Floats32, row: int, x: Any, y: Any, z: Any) -> Vector:
    """`row_along`, and the translation added: a coordinate of moved points [m]."""
    return row_along(poses, row, x, y, z) + load(poses, row + 3 * LANES)


@vector_part
def apply_poses(poses: Floats32, joint: int, x: float, y: float, z: float) -> tuple[Vector, Vector, Vector]:
    """Return where a point of a joint's frame is in the world at sixteen poses (joints * POSE,) [m]."""
    at = joint * POSE
    return moved_row(poses, at, x, y, z), moved_row(poses, at + ROW, x, y, z), moved_row(poses, at + 2 * ROW, x, y, z)


@vector_part
def turned(poses: Floats32, joint: int, x: Any, y: Any, z: Any) -> tuple[Vector, Vector, Vector]:
    """An axis of a joint's moved frame in the world, at sixteen configurations; arguments as for `apply_poses`."""
    at = joint * POSE
    return row_along(poses, at, x, y, z), row_along(poses, at + ROW, x, y, z), row_along(poses, at + 2 * ROW, x, y, z)


@vector_part
def column_along(poses: Floats32, column: int, u: Vector, v: Vector, w: Vector) -> Vector:
    """A column of `poses` (joints * POSE,), which begins there, times three vectors."""
    return load(poses, column) * u + load(poses, column + ROW) * v + load(poses, column + 2 * ROW) * w


@vector_part
def turned_axis(poses: Floats32, joint: int, u: Vector, v: Vector, w: Vector) -> tuple[Vector, Vector, Vector, Vector]:
    """Return a world axis in a joint's frame, and that frame's origin along it; `poses` (joints * POSE,)."""
    at = joint * POSE
    return (
        column_along(poses, at, u, v, w),
        column_along(poses, at + LANES, u, v, w),
        column_along(poses, at + 2 * LANES, u, v, w),
        column_along(poses, at + 3 * LANES, u, v, w),
    )
