"""Chart coordinates of a configuration next to others, robot/model/chart.py's `to_chart` and `unwrapped` in one."""

from __future__ import annotations

import math

from numba import void

from guidefield.kernels.jit.signatures import VECTOR, VECTOR_OUT, Floats, compiled, inlined
from guidefield.kernels.kinematics.forward_kinematics import (
    CONTINUOUS,
    FLOATING,
    JOINTS,
    PLANAR,
    PRISMATIC,
    REVOLUTE,
    JointTable,
)

_TURN = 2.0 * math.pi


@inlined
def _near_angle(angle: float, near: float) -> float:
    """The same angle within half a turn of another [rad]."""
    return angle + _TURN * math.floor((near - angle) / _TURN + 0.5)


@inlined
def _rotation_vector(q: Floats, origin: Floats, at: int, near: Floats, v: int, values_out: Floats) -> None:
    """Rotation vector from a quaternion (x, y, z, w) to another, the long or the short way round: what is nearer."""
    ox, oy, oz, ow = -origin[at], -origin[at + 1], -origin[at + 2], origin[at + 3]
    qx, qy, qz, qw = q[at], q[at + 1], q[at + 2], q[at + 3]
    x = ow * qx + ox * qw + oy * qz - oz * qy
    y = ow * qy - ox * qz + oy * qw + oz * qx
    z = ow * qz + ox * qy - oy * qx + oz * qw
    w = ow * qw - ox * qx - oy * qy - oz * qz
    if w < 0.0:
        x, y, z, w = -x, -y, -z, -w
    sine = math.sqrt(x * x + y * y + z * z)
    angle = 2.0 * math.atan2(sine, w)
    scale = angle / sine if sine > 1e-12 else 2.0
    x, y, z = scale * x, scale * y, scale * z
    if sine > 1e-12:
        other = 1.0 - _TURN / angle
        short = (x - near[v]) ** 2 + (y - near[v + 1]) ** 2 + (z - near[v + 2]) ** 2
        long = (other * x - near[v]) ** 2 + (other * y - near[v + 1]) ** 2 + (other * z - near[v + 2]) ** 2
        if long < short:
            x, y, z = other * x, other * y, other * z
    values_out[v], values_out[v + 1], values_out[v + 2] = x, y, z


@compiled(void(JOINTS, VECTOR, VECTOR, VECTOR, VECTOR_OUT))
def chart_values(joints: JointTable, q: Floats, origin: Floats, near: Floats, values_out: Floats) -> None:
    """Chart coordinates of a configuration, those nearest to others.

    Args:
        joints: The joints.
        q: Configuration, shape (nq,).
        origin: Configuration from which rotation vectors start, shape (nq,).
        near: Chart coordinates, shape (nv,).
        values_out: Shape (nv,).
    """
    for i in range(1, joints.parents.shape[0]):
        at, v, kind = joints.idx_q[i], joints.idx_v[i], joints.kinds[i]
        if kind in (REVOLUTE, PRISMATIC):
            values_out[v] = q[at]
        elif kind == CONTINUOUS:
            values_out[v] = _near_angle(math.atan2(q[at + 1], q[at]), near[v])
        elif kind == PLANAR:
            values_out[v], values_out[v + 1] = q[at], q[at + 1]
            values_out[v + 2] = _near_angle(math.atan2(q[at + 3], q[at + 2]), near[v + 2])
        else:
            if kind == FLOATING:
                values_out[v], values_out[v + 1], values_out[v + 2] = q[at], q[at + 1], q[at + 2]
                at, v = at + 3, v + 3
            _rotation_vector(q, origin, at, near, v, values_out)
