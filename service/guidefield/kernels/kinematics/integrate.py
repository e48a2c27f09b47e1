"""How the joints of a planning group move a robot's model: steps along tangents, limits, the place of the tip.

A group's tangent v gives the model's by ``factor * v[leader]``: joints that mimic others follow them. Steps are
Pinocchio's ``integrate``: additive for axes, the exponential map of the moved frame for the others.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from numba import types, void

from guidefield.kernels.jit.fields import Indices, Row, Rows, numba_type
from guidefield.kernels.jit.signatures import (
    VECTOR,
    VECTOR_OUT,
    Floats,
    Vector3,
    compiled,
    inlined,
)
from guidefield.kernels.kinematics.chart import turned
from guidefield.kernels.kinematics.forward_kinematics import (
    CONTINUOUS,
    PLANAR,
    PRISMATIC,
    REVOLUTE,
    SPHERICAL,
    JointTable,
)
from guidefield.kernels.kinematics.poses import moved_by

_SMALL = 1e-4
"""Below this angle series stand for sine and cosine [rad]: off by less than rounding."""


class Mover(NamedTuple):
    """A group's joints on its model; n joints with the world, m tangents of the model, nv of the group.

    Attributes:
        joints: The joints of the model.
        leaders: (m,) the group's tangent that each of the model's follows.
        factors: (m,) how far it follows.
        norms: (nv,) sum of squared factors of those that follow.
        largest: (nv,) the longest step [rad or m].
        values: (nv,) where in the model's configuration a value with limits stands; -1 where there are none.
        lower, upper: (nv,) the limits.
        stops: (nv,) 1 where a value stops at its limit, 0 where a step beyond it is not taken.
        supports: (n,) 1 where a joint moves the tip.
        tip_joint: The last joint that moves it.
        tip: (3, 4) its placement in that joint's frame.
    """

    joints: JointTable
    leaders: Indices
    factors: Row
    norms: Row
    largest: Row
    values: Indices
    lower: Row
    upper: Row
    stops: Indices
    supports: Indices
    tip_joint: int
    tip: Rows


MOVER = numba_type(Mover)


@inlined
def _carried(q: Floats, at: int, t: Vector3, w: Vector3, q_out: Floats) -> None:
    """Move a position at an index by exp(t, w) in the frame of the quaternion (x, y, z, w) that stands behind it."""
    square = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    angle = math.sqrt(square)
    b, c = 0.5 - square / 24.0, 1.0 / 6.0 - square / 120.0
    if angle > _SMALL:
        b, c = (1.0 - math.cos(angle)) / square, (angle - math.sin(angle)) / (square * angle)
    cross = (w[1] * t[2] - w[2] * t[1], w[2] * t[0] - w[0] * t[2], w[0] * t[1] - w[1] * t[0])
    again = (w[1] * cross[2] - w[2] * cross[1], w[2] * cross[0] - w[0] * cross[2], w[0] * cross[1] - w[1] * cross[0])
    px = t[0] + b * cross[0] + c * again[0]
    py = t[1] + b * cross[1] + c * again[1]
    pz = t[2] + b * cross[2] + c * again[2]
    x, y, z, u = q[at + 3], q[at + 4], q[at + 5], q[at + 6]
    # R p = p + 2 u (r x p) + 2 r x (r x p), r the quaternion's vector
    rx, ry, rz = y * pz - z * py, z * px - x * pz, x * py - y * px
    q_out[at] = q[at] + px + 2.0 * (u * rx + y * rz - z * ry)
    q_out[at + 1] = q[at + 1] + py + 2.0 * (u * ry + z * rx - x * rz)
    q_out[at + 2] = q[at + 2] + pz + 2.0 * (u * rz + x * ry - y * rx)


@inlined
def _turned_unit(q: Floats, at: int, w: Vector3, q_out: Floats) -> None:
    """Turn the quaternion at an index by a rotation vector of its own frame, and make it a unit again."""
    turned(q, w, at, q_out)
    square = q_out[at] ** 2 + q_out[at + 1] ** 2 + q_out[at + 2] ** 2 + q_out[at + 3] ** 2
    over = 1.0 / math.sqrt(square)
    for k in range(4):
        q_out[at + k] *= over


@inlined
def _turned_pair(q: Floats, at: int, angle: float, q_out: Floats) -> None:
    """Turn cosine and sine at an index, and make them a unit again."""
    c, s = math.cos(angle), math.sin(angle)
    x, y = c * q[at] - s * q[at + 1], s * q[at] + c * q[at + 1]
    over = 1.0 / math.sqrt(x * x + y * y)
    q_out[at], q_out[at + 1] = over * x, over * y


@compiled(void(MOVER, VECTOR, VECTOR, VECTOR_OUT))
def integrate(mover: Mover, q: Floats, v: Floats, q_out: Floats) -> None:
    """Configuration of the model that a tangent of the group leads to.

    Args:
        mover: The group's joints.
        q: Configuration of the model, shape (nq,).
        v: Tangent of the group, shape (nv,) [rad or m].
        q_out: Shape (nq,); may be `q` itself.
    """
    joints = mover.joints
    for i in range(1, joints.parents.shape[0]):
        at, r, kind = joints.idx_q[i], joints.idx_v[i], joints.kinds[i]
        a = mover.factors[r] * v[mover.leaders[r]]
        if kind in (REVOLUTE, PRISMATIC):
            q_out[at] = q[at] + a
            continue
        if kind == CONTINUOUS:
            _turned_pair(q, at, a, q_out)
            continue
        b = mover.factors[r + 1] * v[mover.leaders[r + 1]]
        c = mover.factors[r + 2] * v[mover.leaders[r + 2]]
        if kind == PLANAR:
            square = c * c
            first, second = 1.0 - square / 6.0, c * (0.5 - square / 24.0)
            if abs(c) > _SMALL:
                first, second = math.sin(c) / c, (1.0 - math.cos(c)) / c
            px, py = first * a - second * b, second * a + first * b
            q_out[at], q_out[at + 1] = (
                q[at] + q[at + 2] * px - q[at + 3] * py,
                q[at + 1] + q[at + 3] * px + q[at + 2] * py,
            )
            _turned_pair(q, at + 2, c, q_out)
        elif kind == SPHERICAL:
            _turned_unit(q, at, (a, b, c), q_out)
        else:
            w = (
                mover.factors[r + 3] * v[mover.leaders[r + 3]],
                mover.factors[r + 4] * v[mover.leaders[r + 4]],
                mover.factors[r + 5] * v[mover.leaders[r + 5]],
            )
            _carried(q, at, (a, b, c), w, q_out)
            _turned_unit(q, at + 3, w, q_out)


@compiled(types.boolean(MOVER, VECTOR_OUT, VECTOR_OUT))
def clamp(mover: Mover, q: Floats, scratch: Floats) -> bool:
    """Bring values of the model's configuration q (nq,) that are beyond their limits back to them, followers too.

    Args:
        mover: The joints.
        q: Changed in place.
        scratch: Shape (nv,).

    Returns:
        False where a value is beyond a limit at which it doesn't stop.
    """
    beyond = False
    for k in range(mover.values.shape[0]):
        scratch[k] = 0.0
        if mover.values[k] >= 0:
            value = q[mover.values[k]]
            back = min(max(value, mover.lower[k]), mover.upper[k]) - value
            if back != 0.0:
                if mover.stops[k] == 0:
                    return False
                scratch[k] = back
                beyond = True
    if beyond:
        integrate(mover, q, scratch, q)
        for k in range(mover.values.shape[0]):  # to the last digit
            if mover.values[k] >= 0:
                at = mover.values[k]
                q[at] = min(max(q[at], mover.lower[k]), mover.upper[k])
    return True


@inlined
def tip_position(mover: Mover, world: Floats) -> Vector3:
    """Where the tip is [m], from placements of joints, shape (n, 3, 4), and in their frame."""
    p = mover.tip
    return moved_by(world[mover.tip_joint], p[0, 3], p[1, 3], p[2, 3])


@inlined
def tip_jacobian(mover: Mover, subspaces: Floats, tip: Vector3, jacobian_out: Floats) -> None:
    """Jacobian of the tip by the group's tangents: linear rows first, at the tip in the world's axes.

    Args:
        mover: The group's joints.
        subspaces: Motion subspaces of the model's tangents at the world's origin, shape (m, 6).
        tip: Where the tip is in the world [m].
        jacobian_out: Shape (6, nv).
    """
    joints = mover.joints
    jacobian_out[:, :] = 0.0
    for i in range(1, joints.parents.shape[0]):
        if mover.supports[i] == 0:
            continue
        for r in range(joints.idx_v[i], joints.idx_v[i] + joints.nv[i]):
            S, column, factor = subspaces[r], mover.leaders[r], mover.factors[r]
            jacobian_out[0, column] += factor * (S[0] + S[4] * tip[2] - S[5] * tip[1])
            jacobian_out[1, column] += factor * (S[1] + S[5] * tip[0] - S[3] * tip[2])
            jacobian_out[2, column] += factor * (S[2] + S[3] * tip[1] - S[4] * tip[0])
            for c in range(3, 6):
                jacobian_out[c, column] += factor * S[c]
