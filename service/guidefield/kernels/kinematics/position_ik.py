"""The configuration near another whose tip is at a point: Newton's method, the least change weighted with reach."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import types

from guidefield.kernels.jit.signatures import VECTOR, VECTOR_OUT, Floats, compiled, inlined
from guidefield.kernels.kinematics.forward_kinematics import (
    FLOATING,
    PLANAR,
    PRISMATIC,
    joint_placements,
    motion_subspaces,
)
from guidefield.kernels.kinematics.integrate import MOVER, clamp, integrate, tip_jacobian, tip_position
from guidefield.kernels.linalg.small_systems import solve_three

_STEPS = 30
_ARRIVED = 1e-6
"""How exactly the point is reached [m]."""
_LONGEST = 0.4
"""No joint moves more than this in a step [rad or m]."""
_OWN = 0.05
"""Added to what a turn moves: one about the tip itself is not free [m]."""


@inlined
def _weights(mover: Any, world: Floats, weights_out: Floats) -> None:
    """Inverse square of what a unit of each of the group's tangents moves, (nv,): distance of the tip, 1 for slides."""
    joints, tip = mover.joints, tip_position(mover, world)
    for i in range(joints.parents.shape[0] - 1, 0, -1):  # a leader stands before its followers and has the last word
        T, kind = world[i], joints.kinds[i]
        reach = _OWN + math.sqrt((tip[0] - T[0, 3]) ** 2 + (tip[1] - T[1, 3]) ** 2 + (tip[2] - T[2, 3]) ** 2)
        slides = 3 if kind == FLOATING else 2 if kind == PLANAR else 1 if kind == PRISMATIC else 0
        for k in range(joints.nv[i]):
            weights_out[mover.leaders[joints.idx_v[i] + k]] = 1.0 if k < slides else 1.0 / (reach * reach)


@inlined
def _step(mover: Any, q: Floats, jacobian: Floats, weights: Floats, missing: Floats, room: Any, v_out: Floats) -> None:
    """The least change that moves the tip by what is missing, without joints that it would push beyond a limit."""
    stopped, gram, multiplier = room
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


@compiled(types.boolean(MOVER, VECTOR, VECTOR, VECTOR_OUT))
def reach(mover: Any, q: Floats, point: Floats, q_out: Floats) -> bool:
    """Bring the tip to a point.

    Args:
        mover: The joints that move.
        q: Configuration of the model, shape (nq,).
        point: Where the tip shall be, shape (3,) [m, world].
        q_out: The configuration found, within the limits, shape (nq,).

    Returns:
        Whether Newton's method got there.
    """
    joints, n, m, nv = mover.joints, mover.joints.parents.shape[0], mover.leaders.shape[0], mover.values.shape[0]
    world, subspaces, jacobian = np.empty((n, 3, 4)), np.empty((m, 6)), np.empty((6, nv))
    weights, v, missing = np.zeros(nv), np.empty(nv), np.empty(3)
    room = (np.zeros(nv, np.int64), np.empty((3, 3)), np.empty(3))
    q_out[:] = q
    for count in range(_STEPS):
        joint_placements(joints, q_out, world)
        tip = tip_position(mover, world)
        missing[0], missing[1], missing[2] = point[0] - tip[0], point[1] - tip[1], point[2] - tip[2]
        if math.sqrt(missing[0] ** 2 + missing[1] ** 2 + missing[2] ** 2) < _ARRIVED:
            return True
        if count == 0:
            _weights(mover, world, weights)
        motion_subspaces(joints, world, subspaces)
        tip_jacobian(mover, subspaces, tip, jacobian)
        _step(mover, q_out, jacobian, weights, missing, room, v)
        largest = 0.0
        for k in range(nv):
            largest = max(largest, abs(v[k]))
        scale = min(1.0, _LONGEST / max(largest, 1e-12))
        for k in range(nv):
            v[k] *= scale
        integrate(mover, q_out, v, q_out)
        if not clamp(mover, q_out, v):
            return False
    return False
