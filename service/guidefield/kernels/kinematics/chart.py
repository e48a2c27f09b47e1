"""Configurations of chart coordinates, and motion subspaces by them; robot/model/chart.py says what they are.

A joint moves with its chart coordinates z as with the tangent velocities M(z) dz/dt, in its motion subspace S: M turns
positions into the moved frame, and is the right Jacobian of the exponential map for rotation vectors,

    J_r(v) = 1 - (1 - cos|v|)/|v|^2 [v] + (|v| - sin|v|)/|v|^3 [v]^2.
"""

from __future__ import annotations

import math

from guidefield.kernels.jit.no_refcount import uncounted
from guidefield.kernels.jit.signatures import Floats, Vector3, inlined
from guidefield.kernels.kinematics.forward_kinematics import (
    CONTINUOUS,
    FLOATING,
    PLANAR,
    PRISMATIC,
    REVOLUTE,
    SPHERICAL,
    JointTable,
    place_joints,
)

_SMALL = 1e-4
"""Below this angle series stand for sine and cosine [rad]: off by less than rounding."""


@inlined
def configuration(joints: JointTable, values: Floats, origin: Floats, q_out: Floats) -> None:
    """Configuration of chart coordinates.

    Args:
        joints: The joints.
        values: Chart coordinates, shape (nv,).
        origin: Configuration from which rotation vectors start, shape (nq,).
        q_out: Shape (nq,).
    """
    for i in range(1, joints.parents.shape[0]):
        v, q, kind = joints.idx_v[i], joints.idx_q[i], joints.kinds[i]
        if kind in (REVOLUTE, PRISMATIC):
            q_out[q] = values[v]
        elif kind == CONTINUOUS:
            q_out[q], q_out[q + 1] = math.cos(values[v]), math.sin(values[v])
        elif kind == PLANAR:
            q_out[q], q_out[q + 1] = values[v], values[v + 1]
            q_out[q + 2], q_out[q + 3] = math.cos(values[v + 2]), math.sin(values[v + 2])
        else:
            if kind == FLOATING:
                q_out[q], q_out[q + 1], q_out[q + 2] = values[v], values[v + 1], values[v + 2]
                v, q = v + 3, q + 3
            turned(origin, (values[v], values[v + 1], values[v + 2]), q, q_out)


@uncounted
def place_by_chart(
    joints: JointTable,
    values: Floats,
    origin: Floats,
    q_out: Floats,
    rotation: Floats,
    translation: Floats,
    poses_out: Floats,
) -> None:
    """Place joints at chart coordinates.

    Args:
        joints: The joints.
        values: As in `configuration`, and so are the next two.
        origin: See there.
        q_out: See there.
        rotation: Scratch of a joint, shape (3, 3).
        translation: Scratch of a joint, shape (3,).
        poses_out: Placements in the world, shape (n, 3, 4) [m].
    """
    configuration(joints, values, origin, q_out)
    place_joints(joints, q_out, rotation, translation, poses_out)


@inlined
def subspaces_by_chart(joints: JointTable, values: Floats, q: Floats, subspaces_out: Floats) -> None:
    """Replace the rows of motion subspaces by those that chart velocities cause: M^T S.

    Args:
        joints: The joints.
        values: Chart coordinates, shape (nv,).
        q: Their configuration, shape (nq,).
        subspaces_out: Rows of `motion_subspaces`, shape (nv, 6).
    """
    for i in range(1, joints.parents.shape[0]):
        v, kind = joints.idx_v[i], joints.kinds[i]
        if kind == PLANAR:
            c, s = q[joints.idx_q[i] + 2], q[joints.idx_q[i] + 3]
            _combine(v, (c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0), subspaces_out)
        if kind == FLOATING:
            a, b, c = _rotation_rows(q, joints.idx_q[i] + 3)
            _combine(v, a, b, c, subspaces_out)
            v += 3
        if kind in (SPHERICAL, FLOATING):
            a, b, c = _right_jacobian_columns((values[v], values[v + 1], values[v + 2]))
            _combine(v, a, b, c, subspaces_out)


@inlined
def _combine(v: int, a: Vector3, b: Vector3, c: Vector3, subspaces_out: Floats) -> None:
    """Replace three rows by their combinations with the coefficients a, b and c."""
    for k in range(6):
        x, y, z = subspaces_out[v, k], subspaces_out[v + 1, k], subspaces_out[v + 2, k]
        subspaces_out[v, k] = a[0] * x + a[1] * y + a[2] * z
        subspaces_out[v + 1, k] = b[0] * x + b[1] * y + b[2] * z
        subspaces_out[v + 2, k] = c[0] * x + c[1] * y + c[2] * z


@inlined
def turned(origin: Floats, vector: Vector3, at: int, q_out: Floats) -> None:
    """A quaternion turned by a rotation vector in its own frame.

    Args:
        origin: Configuration that holds the quaternion (x, y, z, w), shape (nq,).
        vector: Rotation vector (3) [rad].
        at: Index of x, in both.
        q_out: Configuration that gets the product, shape (nq,).
    """
    angle = math.sqrt(vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2])
    scale = math.sin(0.5 * angle) / angle if angle > _SMALL else 0.5 - angle * angle / 48.0
    ex, ey, ez, ew = scale * vector[0], scale * vector[1], scale * vector[2], math.cos(0.5 * angle)
    x, y, z, w = origin[at], origin[at + 1], origin[at + 2], origin[at + 3]
    q_out[at] = w * ex + x * ew + y * ez - z * ey
    q_out[at + 1] = w * ey - x * ez + y * ew + z * ex
    q_out[at + 2] = w * ez + x * ey - y * ex + z * ew
    q_out[at + 3] = w * ew - x * ex - y * ey - z * ez


@inlined
def _rotation_rows(q: Floats, at: int) -> tuple[Vector3, Vector3, Vector3]:
    """Rows of the rotation matrix of the unit quaternion (x, y, z, w) at an index."""
    x, y, z, w = q[at], q[at + 1], q[at + 2], q[at + 3]
    return (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)),
        (2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)),
        (2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)),
    )


@inlined
def _right_jacobian_columns(v: Vector3) -> tuple[Vector3, Vector3, Vector3]:
    """Columns of the right Jacobian of the exponential map."""
    x, y, z = v
    square = x * x + y * y + z * z
    angle = math.sqrt(square)
    small = angle < _SMALL
    safe = 1.0 if small else angle
    a = 0.5 - square / 24.0 if small else (1.0 - math.cos(angle)) / (safe * safe)
    b = 1.0 / 6.0 - square / 120.0 if small else (angle - math.sin(angle)) / (safe * safe * safe)
    rest = 1.0 - b * square
    return (
        (rest + b * x * x, b * x * y - a * z, b * x * z + a * y),
        (b * x * y + a * z, rest + b * y * y, b * y * z - a * x),
        (b * x * z - a * y, b * y * z + a * x, rest + b * z * z),
    )
