"""Steps of a group's joints along tangents, within limits, and Newton's method for the tip's position.

A group's tangent v gives the model's by ``factors[r] * v[leaders[r]]``: mimic joints follow their source joints. Steps
are Pinocchio's ``integrate``: additive for axes, the exponential map of the moved frame for the others. Minimizers and
guided paths (`kernels/guide`, `planner/guide`) go by it: the constants of Newton's method change which paths they find,
and no proof relies on them.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from guidefield.kernels.jit.arrays import Floats, Indices, Row, RowOut, Rows, Vector3, numba_type
from guidefield.kernels.jit.decorators import inlined, kernel
from guidefield.kernels.kinematics.forward_kinematics import (
    CONTINUOUS,
    FLOATING,
    PLANAR,
    PRISMATIC,
    REVOLUTE,
    SPHERICAL,
    JointTable,
    joint_placements,
    motion_subspaces,
    turned,
)
from guidefield.kernels.kinematics.poses import moved_by
from guidefield.kernels.linalg.small_systems import solve_three

_SMALL = 1e-4  # below this angle series stand for sine and cosine [rad]: off by less than rounding; less loses digits


class Mover(NamedTuple):
    """A group's joints on its model; n joints with the world, m tangents of the model, nv of the group."""

    joints: JointTable  # the joints of the model
    leaders: Indices  # (m,) the group's tangent that each of the model's follows
    factors: Row  # (m,) how far it follows
    norms: Row  # (nv,) sum of squared factors of those that follow
    largest: Row  # (nv,) the longest step, over `sizes` [rad or m]
    size: float  # the robot's
    sizes: Row  # (nv,) how far each goes for one step: 1 for angles, the size for what slides
    values: Indices  # (nv,) where in the model's configuration a value with limits stands; -1 where there are none
    # lower, upper: (nv,) the limits
    lower: Row
    upper: Row
    stops: Indices  # (nv,) 1 where a value stops at its limit, 0 where a step beyond it is not taken
    supports: Indices  # (n,) 1 where a joint moves the tip
    tip_joint: int  # the last joint that moves it
    tip: Rows  # (3, 4) its placement in that joint's frame


MOVER = numba_type(Mover)


@inlined
def _carry(q: Floats, at: int, t: Vector3, w: Vector3, q_out: Floats) -> None:
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
def _turn_unit(q: Floats, at: int, w: Vector3, q_out: Floats) -> None:
    """Turn the quaternion at an index by a rotation vector of its own frame, and make it a unit again."""
    turned(q, w, at, q_out)
    square = q_out[at] ** 2 + q_out[at + 1] ** 2 + q_out[at + 2] ** 2 + q_out[at + 3] ** 2
    over = 1.0 / math.sqrt(square)
    for k in range(4):
        q_out[at + k] *= over


@inlined
def _turn_pair(q: Floats, at: int, angle: float, q_out: Floats) -> None:
    """Turn cosine and sine at an index, and make them a unit again."""
    c, s = math.cos(angle), math.sin(angle)
    x, y = c * q[at] - s * q[at + 1], s * q[at] + c * q[at + 1]
    over = 1.0 / math.sqrt(x * x + y * y)
    q_out[at], q_out[at + 1] = over * x, over * y


@kernel
def integrate(mover: Mover, q: Row, v: Row, q_out: RowOut) -> None:
    """Write the configuration (nq,) that a tangent (nv,) of the group leads to; it may be q itself."""
    joints = mover.joints
    for i in range(1, joints.parents.shape[0]):
        at, r, kind = joints.idx_q[i], joints.idx_v[i], joints.kinds[i]
        a = mover.factors[r] * v[mover.leaders[r]]
        if kind in (REVOLUTE, PRISMATIC):
            q_out[at] = q[at] + a
            continue
        if kind == CONTINUOUS:
            _turn_pair(q, at, a, q_out)
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
            _turn_pair(q, at + 2, c, q_out)
        elif kind == SPHERICAL:
            _turn_unit(q, at, (a, b, c), q_out)
        else:
            w = (
                mover.factors[r + 3] * v[mover.leaders[r + 3]],
                mover.factors[r + 4] * v[mover.leaders[r + 4]],
                mover.factors[r + 5] * v[mover.leaders[r + 5]],
            )
            _carry(q, at, (a, b, c), w, q_out)
            _turn_unit(q, at + 3, w, q_out)


@kernel
def clamp(mover: Mover, q: RowOut, scratch: RowOut) -> bool:
    """Bring values of a configuration (nq,) that are beyond their limits back, mimic joints' too; scratch (nv,).

    It is false where a value is beyond a limit at which it doesn't stop.
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
    """Return where the tip is [m], from placements of joints, shape (n, 3, 4), and in their frame."""
    p = mover.tip
    return moved_by(world[mover.tip_joint], p[0, 3], p[1, 3], p[2, 3])


@inlined
def tip_jacobian(mover: Mover, subspaces: Floats, tip: Vector3, jacobian_out: Floats) -> None:
    """Write the tip's Jacobian (6, nv) by the group's tangents: linear rows first, at the tip in the world's axes.

    `subspaces` (m, 6) are those of the model's tangents at the world's origin, `tip` is the tip's place [m].
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


_STEPS = 30  # of Newton's method, at most
_ARRIVED = 1e-6  # accuracy with which the point is reached [m], at size 1; far below `ON_PLANE` of guide/rounds.py
_LONGEST = 0.4  # no joint moves more than this in a step [rad, or m at size 1]
_OWN = 0.05  # added to the lever of a turn, so that one about the tip itself isn't free [m], at size 1


@inlined
def _weights(mover: Any, world: Floats, weights_out: Floats) -> None:
    """Inverse square of what a unit of each of the group's tangents moves, (nv,): distance of the tip, 1 for slides."""
    joints, tip = mover.joints, tip_position(mover, world)
    for i in range(joints.parents.shape[0] - 1, 0, -1):  # a source joint precedes its mimic joints: it decides
        T, kind = world[i], joints.kinds[i]
        reach = _OWN * mover.size + math.sqrt(
            (tip[0] - T[0, 3]) ** 2 + (tip[1] - T[1, 3]) ** 2 + (tip[2] - T[2, 3]) ** 2
        )
        slides = 3 if kind == FLOATING else 2 if kind == PLANAR else 1 if kind == PRISMATIC else 0
        for k in range(joints.nv[i]):
            weights_out[mover.leaders[joints.idx_v[i] + k]] = 1.0 if k < slides else 1.0 / (reach * reach)


@inlined
def _step(
    mover: Any, q: Floats, jacobian: Floats, weights: Floats, missing: Floats, buffers: Any, v_out: Floats
) -> None:
    """The least change that moves the tip by what is missing, without joints that it would push beyond a limit."""
    stopped, gram, multiplier = buffers
    nv = v_out.shape[0]
    stopped[:] = 0
    for _ in range(nv):
        for a in range(3):
            for b in range(3):
                value = 0.0
                for k in range(nv):
                    if stopped[k] == 0:
                        value += jacobian[a, k] * weights[k] * jacobian[b, k]
                gram[a, b] = value
        ridge = 1e-9 * max(gram[0, 0] + gram[1, 1] + gram[2, 2], 1e-12)
        solve_three(gram, ridge, missing, multiplier)
        fresh = False
        for k in range(nv):
            along = jacobian[0, k] * multiplier[0] + jacobian[1, k] * multiplier[1] + jacobian[2, k] * multiplier[2]
            v_out[k] = 0.0 if stopped[k] == 1 else weights[k] * along
            at = mover.values[k]
            watched = at >= 0 and mover.stops[k] == 1 and stopped[k] == 0
            low = watched and q[at] <= mover.lower[k] and v_out[k] < 0.0
            if low or (watched and q[at] >= mover.upper[k] and v_out[k] > 0.0):
                stopped[k] = 1
                fresh = True
        if not fresh:
            return


@kernel
def reach(mover: Mover, q: Row, point: Row, q_out: RowOut) -> bool:
    """Bring the tip to a point (3,) [m, world] by Newton's method, within the limits; tell whether it got there.

    From the configuration q (nq,); the one found is `q_out` (nq,).
    """
    joints, n, m, nv = mover.joints, mover.joints.parents.shape[0], mover.leaders.shape[0], mover.values.shape[0]
    world, subspaces, jacobian = np.empty((n, 3, 4)), np.empty((m, 6)), np.empty((6, nv))
    weights, v, missing = np.zeros(nv), np.empty(nv), np.empty(3)
    buffers = (np.zeros(nv, np.int64), np.empty((3, 3)), np.empty(3))
    q_out[:] = q
    for count in range(_STEPS):
        joint_placements(joints, q_out, world)
        tip = tip_position(mover, world)
        missing[0], missing[1], missing[2] = point[0] - tip[0], point[1] - tip[1], point[2] - tip[2]
        if math.sqrt(missing[0] ** 2 + missing[1] ** 2 + missing[2] ** 2) < _ARRIVED * mover.size:
            return True
        if count == 0:
            _weights(mover, world, weights)
        motion_subspaces(joints, world, subspaces)
        tip_jacobian(mover, subspaces, tip, jacobian)
        _step(mover, q_out, jacobian, weights, missing, buffers, v)
        largest = 0.0
        for k in range(nv):
            largest = max(largest, abs(v[k]) / mover.sizes[k])
        scale = min(1.0, _LONGEST / max(largest, 1e-12))
        for k in range(nv):
            v[k] *= scale
        integrate(mover, q_out, v, q_out)
        if not clamp(mover, q_out, v):
            return False
    return False
