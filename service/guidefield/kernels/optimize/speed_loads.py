"""Speeds in space along a motion as loads, evaluated on samples: see `load_penalty`.

Sums of squares have to be those there. Loads lead the optimizer alone: limits are checked by `planner/task`, on bounds.

The velocity of a carried point p is the sum of J_j z'_j, with J_j the velocity by joint j alone. Joint j turns those by
later joints, and moves p, which those by itself and earlier joints turn about their axes: with w the joints' axes,

    dv/dz_j = w_j x (velocity by later joints) + (turning of joints up to j) x J_j
"""

from __future__ import annotations

import math

import numpy as np

from guidefield.kernels.jit.arrays import Blocks, BlocksOut, Floats, IndicesOut, Row, RowOut, Rows
from guidefield.kernels.jit.decorators import kernel, uncounted
from guidefield.kernels.kinematics.forward_kinematics import (
    JointPlaces,
    joint_places,
    place_group,
    velocity_by,
    write_twists,
)
from guidefield.kernels.kinematics.poses import moved_by
from guidefield.kernels.optimize.torque_loads import write_sample
from guidefield.kernels.timing.carried_rates import CarriedBody, CoordinateBounds, empty_bounds


@uncounted
def _fastest(
    body: CarriedBody, state: CoordinateBounds, places: JointPlaces, twist: Floats
) -> tuple[float, float, float, float]:
    """Return the largest speed of the points, and where that point is; write the body's twist."""
    joints = body.joints
    place_group(joints, state.z, places)
    write_twists(joints, places)
    twist[:] = 0.0
    for row in range(joints.sources.shape[0]):
        rate = joints.multipliers[row] * state.dz[joints.sources[row]]
        for k in range(6):
            twist[k] += rate * places.twists[row, k]
    pose = places.poses[joints.table.parents.shape[0] - 1]
    turning = math.sqrt(twist[3] ** 2 + twist[4] ** 2 + twist[5] ** 2)
    fastest, px, py, pz = -1.0, 0.0, 0.0, 0.0
    for k in range(body.points.shape[0]):
        x, y, z = moved_by(pose, body.points[k, 0], body.points[k, 1], body.points[k, 2])
        vx, vy, vz = velocity_by(twist, x, y, z)
        speed = math.sqrt(vx * vx + vy * vy + vz * vz) + body.radii[k] * turning
        if speed > fastest:
            fastest, px, py, pz = speed, x, y, z
    return fastest, px, py, pz


@kernel
def largest_speed_loads(
    body: CarriedBody, limit: float, points: Rows, step: float, bases: Blocks, share: float, loads_out: RowOut
) -> float:
    """Write the load at each sample; return the sum of squares beyond a share, as in `torque_loads`."""
    nv, pieces, total = points.shape[1], points.shape[0] - 3, 0.0
    places, state, twist = joint_places(body.joints), empty_bounds(nv, body.joints.sources.shape[0]), np.empty(6)
    for at in range(pieces * bases.shape[0]):
        write_sample(points, at // bases.shape[0], step, bases[at % bases.shape[0]], state)
        loads_out[at] = _fastest(body, state, places, twist)[0] / limit
        total += max(loads_out[at] - share, 0.0) ** 2
    return total


@kernel
def expand_speed_loads(
    body: CarriedBody,
    limit: float,
    points: Rows,
    step: float,
    bases: Blocks,
    loads: Row,
    near: float,
    count: int,
    pieces_out: IndicesOut,
    samples_out: IndicesOut,
    values_out: RowOut,
    slopes_out: BlocksOut,
) -> int:
    """Expand loads above a share, three rows each, behind those that are there; return how many rows there are then.

    See `torque_loads.expand_torque_loads`. Where points are balls their turning counts as if the velocity were longer:
    `scale` follows what `_fastest` takes for the speed.
    """
    nv, joints = points.shape[1], body.joints
    places, state, twist = joint_places(joints), empty_bounds(nv, joints.sources.shape[0]), np.empty(6)
    up_to = np.empty(6)
    for at in range(loads.shape[0]):
        if loads[at] <= near:
            continue
        write_sample(points, at // bases.shape[0], step, bases[at % bases.shape[0]], state)
        speed, x, y, z = _fastest(body, state, places, twist)
        vx, vy, vz = velocity_by(twist, x, y, z)
        scale = speed / (limit * max(math.sqrt(vx * vx + vy * vy + vz * vz), 1e-300))
        slopes_out[count : count + 3, :, :] = 0.0
        up_to[:] = 0.0
        for row in range(joints.sources.shape[0]):
            s, source, by = places.twists[row], joints.sources[row], joints.multipliers[row]
            for k in range(6):
                up_to[k] += by * state.dz[source] * s[k]
            jx, jy, jz = velocity_by(s, x, y, z)
            hx, hy, hz = velocity_by(up_to, x, y, z)
            rx, ry, rz = vx - hx, vy - hy, vz - hz
            by *= scale
            slopes_out[count, 1, source] += by * jx
            slopes_out[count + 1, 1, source] += by * jy
            slopes_out[count + 2, 1, source] += by * jz
            slopes_out[count, 0, source] += by * (s[4] * rz - s[5] * ry + up_to[4] * jz - up_to[5] * jy)
            slopes_out[count + 1, 0, source] += by * (s[5] * rx - s[3] * rz + up_to[5] * jx - up_to[3] * jz)
            slopes_out[count + 2, 0, source] += by * (s[3] * ry - s[4] * rx + up_to[3] * jy - up_to[4] * jx)
        values_out[count], values_out[count + 1], values_out[count + 2] = scale * vx, scale * vy, scale * vz
        for _ in range(3):
            pieces_out[count], samples_out[count] = at // bases.shape[0], at % bases.shape[0]
            for p in range(nv):
                values_out[count] -= slopes_out[count, 0, p] * state.z[p] + slopes_out[count, 1, p] * state.dz[p]
            count += 1
    return count
