"""Loads of a motion at samples, torques and speeds in space, and their linear expansions: rows of `LoadModel`.

They lead the optimizer alone: limits are checked by `planner/task`, on bounds, so that wrong derivatives find worse
motions and break no limit. Sums of squares have to be those of `penalties.load_penalty`, which Newton's method lowers.

Torques: with S_j the twist of coordinate j in the world, v and a the twist and its derivative before it, let

    ψ_j = v x S_j        A_j = a x S_j + v x ψ_j

A body's wrench Y a' + v' x* Y v' then changes by Y A_j + D ψ_j with coordinate j, in axes that j moves along, by
2 Y ψ_j + D S_j with its velocity, and by Y S_j with its acceleration, where j moves the body, and

    D ψ = v' x* Y ψ - Y (v' x ψ) + ψ x* Y v'

keeps three numbers and a matrix of nine. Sums of Y and D over what a joint carries give the torque's. Source:
J. Carpentier and N. Mansard, "Analytical derivatives of rigid body dynamics algorithms", Robotics: Science and Systems
XIV, 2018.

Speeds: the velocity of a carried point p is the sum of J_j z'_j, with J_j the velocity by joint j alone. Joint j turns
those by later joints, and moves p, which those by itself and earlier joints turn about their axes: with w the joints'
axes,

    dv/dz_j = w_j x (velocity by later joints) + (turning of joints up to j) x J_j
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from guidefield.kernels.jit.arrays import Blocks, BlocksOut, Floats, IndicesOut, Row, RowOut, Rows, RowsOut, Vector3
from guidefield.kernels.jit.decorators import counted, kernel, uncounted
from guidefield.kernels.kinematics.forward_kinematics import (
    JointPlaces,
    joint_places,
    place_group,
    velocity_by,
    write_twists,
)
from guidefield.kernels.kinematics.poses import moved_by
from guidefield.kernels.timing.carried_rates import CarriedBody, CoordinateBounds, empty_bounds
from guidefield.kernels.timing.torques import (
    MassTree,
    TorqueBuffers,
    allocate_torque_buffers,
    place_tree,
    write_torques,
)

MASS, MOMENT, INERTIA, MOMENTUM, TURNING = 0, 1, 4, 10, 13  # columns of `DerivativeBuffers.carried`
CARRIED = 22  # their number


class DerivativeBuffers(NamedTuple):
    """Buffers: of joints what they carry; of coordinates ψ and A, and their wrenches and those of S."""

    carried: RowsOut  # shape (n, CARRIED): mass, its first and second moments, momentum, and the matrix of D
    changes: RowsOut  # ψ, A, shape (m, 12)
    wrenches: RowsOut  # Y S, D's transpose of S; Y A + D ψ + S x* F; 2 Y ψ + D S, shape (m, 21)
    before: RowsOut  # a twist and its derivative, shape (2, 6)
    by: BlocksOut  # the derivatives [order, torque, coordinate], shape (3, nv, nv)


@counted
def allocate_derivative_buffers(n: int, m: int, nv: int) -> DerivativeBuffers:
    """Allocate the buffers for n joints, m coordinates of the model, nv of the group."""
    scratch = np.empty((n, CARRIED)), np.empty((m, 12)), np.empty((m, 21)), np.empty((2, 6))
    return DerivativeBuffers(scratch[0], scratch[1], scratch[2], scratch[3], np.empty((3, nv, nv)))


@uncounted
def _cross(ax: float, ay: float, az: float, bx: float, by: float, bz: float) -> Vector3:
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@uncounted
def _write_carried(tree: MassTree, places: JointPlaces, twists: Floats, carried: Floats) -> None:
    """Write what each joint carries, what later joints carry included."""
    parents = tree.joints.table.parents
    for i in range(1, parents.shape[0]):
        row, pose, mass, own = carried[i], places.poses[i], tree.masses[i], tree.inertias[i]
        centre = tree.centres[i]
        cx, cy, cz = moved_by(pose, centre[0], centre[1], centre[2])
        mx, my, mz = mass * cx, mass * cy, mass * cz
        row[MASS], row[MOMENT], row[MOMENT + 1], row[MOMENT + 2] = mass, mx, my, mz
        # about the world's origin: xx, xy, xz, yy, yz, zz
        at = INERTIA
        for a in range(3):
            ux = pose[a, 0] * own[0, 0] + pose[a, 1] * own[1, 0] + pose[a, 2] * own[2, 0]
            uy = pose[a, 0] * own[0, 1] + pose[a, 1] * own[1, 1] + pose[a, 2] * own[2, 1]
            uz = pose[a, 0] * own[0, 2] + pose[a, 1] * own[1, 2] + pose[a, 2] * own[2, 2]
            for b in range(a, 3):
                row[at] = ux * pose[b, 0] + uy * pose[b, 1] + uz * pose[b, 2]
                at += 1
        row[INERTIA] += my * cy + mz * cz
        row[INERTIA + 1] -= mx * cy
        row[INERTIA + 2] -= mx * cz
        row[INERTIA + 3] += mx * cx + mz * cz
        row[INERTIA + 4] -= my * cz
        row[INERTIA + 5] += mx * cx + my * cy
        xx, xy, xz = row[INERTIA], row[INERTIA + 1], row[INERTIA + 2]
        yy, yz, zz = row[INERTIA + 3], row[INERTIA + 4], row[INERTIA + 5]
        vx, vy, vz, wx, wy, wz = twists[i, 0], twists[i, 1], twists[i, 2], twists[i, 3], twists[i, 4], twists[i, 5]
        px, py, pz = _cross(wx, wy, wz, mx, my, mz)
        row[MOMENTUM], row[MOMENTUM + 1], row[MOMENTUM + 2] = mass * vx + px, mass * vy + py, mass * vz + pz
        hx, hy, hz = _cross(mx, my, mz, vx, vy, vz)
        hx += xx * wx + xy * wy + xz * wz
        hy += xy * wx + yy * wy + yz * wz
        hz += xz * wx + yz * wy + zz * wz
        # [w] I - I [w] - [h] - (c v' + v c') + 2 v · c, with c the first moment
        both = 2.0 * (vx * mx + vy * my + vz * mz)
        row[TURNING] = 2.0 * (wy * xz - wz * xy) - 2.0 * mx * vx + both
        row[TURNING + 4] = 2.0 * (wz * xy - wx * yz) - 2.0 * my * vy + both
        row[TURNING + 8] = 2.0 * (wx * yz - wy * xz) - 2.0 * mz * vz + both
        upper = wy * yz - wz * yy + wz * xx - wx * xz - mx * vy - my * vx
        row[TURNING + 1], row[TURNING + 3] = upper + hz, upper - hz
        upper = wy * zz - wz * yz + wx * xy - wy * xx - mx * vz - mz * vx
        row[TURNING + 2], row[TURNING + 6] = upper - hy, upper + hy
        upper = wz * xz - wx * zz + wx * yy - wy * xy - my * vz - mz * vy
        row[TURNING + 5], row[TURNING + 7] = upper + hx, upper - hx
    for i in range(parents.shape[0] - 1, 0, -1):
        if parents[i] > 0:
            into = carried[parents[i]]
            for k in range(CARRIED):
                into[k] += carried[i, k]


@uncounted
def _add_inertial(row: Floats, of: Floats, by: float, wrench_out: Floats) -> None:
    """Add to a wrench what the mass that is carried makes of a twist."""
    vx, vy, vz, wx, wy, wz = of[0], of[1], of[2], of[3], of[4], of[5]
    mass, mx, my, mz = row[MASS], row[MOMENT], row[MOMENT + 1], row[MOMENT + 2]
    fx, fy, fz = _cross(wx, wy, wz, mx, my, mz)
    tx, ty, tz = _cross(mx, my, mz, vx, vy, vz)
    wrench_out[0] += by * (mass * vx + fx)
    wrench_out[1] += by * (mass * vy + fy)
    wrench_out[2] += by * (mass * vz + fz)
    wrench_out[3] += by * (tx + row[INERTIA] * wx + row[INERTIA + 1] * wy + row[INERTIA + 2] * wz)
    wrench_out[4] += by * (ty + row[INERTIA + 1] * wx + row[INERTIA + 3] * wy + row[INERTIA + 4] * wz)
    wrench_out[5] += by * (tz + row[INERTIA + 2] * wx + row[INERTIA + 4] * wy + row[INERTIA + 5] * wz)


@uncounted
def _add_turning(row: Floats, of: Floats, wrench_out: Floats) -> None:
    """Add to a wrench what D makes of a twist."""
    wx, wy, wz = of[3], of[4], of[5]
    fx, fy, fz = _cross(wx, wy, wz, row[MOMENTUM], row[MOMENTUM + 1], row[MOMENTUM + 2])
    wrench_out[0] += 2.0 * fx
    wrench_out[1] += 2.0 * fy
    wrench_out[2] += 2.0 * fz
    for a in range(3):
        at = TURNING + 3 * a
        wrench_out[3 + a] += row[at] * wx + row[at + 1] * wy + row[at + 2] * wz


@uncounted
def _write_turned(row: Floats, of: Floats, out: Floats) -> None:
    """Write what the transpose of D makes of a twist: its first three numbers are 0."""
    fx, fy, fz = _cross(row[MOMENTUM], row[MOMENTUM + 1], row[MOMENTUM + 2], of[0], of[1], of[2])
    out[0], out[1], out[2] = 2.0 * fx, 2.0 * fy, 2.0 * fz
    for a in range(3):
        at = TURNING + a
        out[a] += row[at] * of[3] + row[at + 3] * of[4] + row[at + 6] * of[5]


@uncounted
def _times(twist: Floats, of: Floats, out: Floats) -> None:
    """Write the product v x S of a twist and another."""
    ax, ay, az = _cross(twist[3], twist[4], twist[5], of[0], of[1], of[2])
    bx, by, bz = _cross(twist[0], twist[1], twist[2], of[3], of[4], of[5])
    out[0], out[1], out[2] = ax + bx, ay + by, az + bz
    out[3], out[4], out[5] = _cross(twist[3], twist[4], twist[5], of[3], of[4], of[5])


@uncounted
def _write_coordinate(
    row: int,
    carried: Floats,
    places: JointPlaces,
    twist: Floats,
    change: Floats,
    force: Floats,
    buffers: DerivativeBuffers,
) -> None:
    """Write ψ, A and the wrenches of a coordinate, by twist and change before it, and the wrench that it carries."""
    s, psi, of_a = places.twists[row], buffers.changes[row, :6], buffers.changes[row, 6:]
    _times(twist, s, psi)
    _times(twist, psi, of_a)
    extra = buffers.wrenches[row, :6]
    _times(change, s, extra)
    for k in range(6):
        of_a[k] += extra[k]
    inertial, turned = buffers.wrenches[row, :6], buffers.wrenches[row, 6:9]
    by_point, by_rate = buffers.wrenches[row, 9:15], buffers.wrenches[row, 15:21]
    inertial[:] = 0.0
    _add_inertial(carried, s, 1.0, inertial)
    _write_turned(carried, s, turned)
    # S x* F
    ax, ay, az = _cross(s[3], s[4], s[5], force[0], force[1], force[2])
    bx, by, bz = _cross(s[3], s[4], s[5], force[3], force[4], force[5])
    cx, cy, cz = _cross(s[0], s[1], s[2], force[0], force[1], force[2])
    by_point[0], by_point[1], by_point[2] = ax, ay, az
    by_point[3], by_point[4], by_point[5] = bx + cx, by + cy, bz + cz
    _add_inertial(carried, of_a, 1.0, by_point)
    _add_turning(carried, psi, by_point)
    by_rate[:] = 0.0
    _add_inertial(carried, psi, 2.0, by_rate)
    _add_turning(carried, s, by_rate)


@uncounted
def _dot(a: Floats, b: Floats) -> float:
    total = 0.0
    for k in range(6):
        total += a[k] * b[k]
    return total


@uncounted
def write_torque_derivatives(
    tree: MassTree, state: CoordinateBounds, places: JointPlaces, buffers: TorqueBuffers, made: DerivativeBuffers
) -> None:
    """Write the derivatives of torques where `torques.write_torques` wrote them."""
    joints, table, by = tree.joints, tree.joints.table, made.by
    _write_carried(tree, places, buffers.twists, made.carried)
    by[:, :, :] = 0.0
    twist, change = made.before[0], made.before[1]
    for i in range(1, table.parents.shape[0]):
        for k in range(6):
            twist[k], change[k] = buffers.twists[table.parents[i], k], buffers.changes[table.parents[i], k]
        for own in range(table.nv[i]):
            row = table.idx_v[i] + own
            _write_coordinate(row, made.carried[i], places, twist, change, buffers.wrenches[i], made)
            if own + 1 < table.nv[i]:
                source, multiplier = joints.sources[row], joints.multipliers[row]
                for k in range(6):
                    change[k] += multiplier * (
                        places.twists[row, k] * state.ddz[source] + made.changes[row, k] * state.dz[source]
                    )
                    twist[k] += multiplier * places.twists[row, k] * state.dz[source]
            inertial, turned = made.wrenches[row, :6], made.wrenches[row, 6:9]
            here, share = joints.sources[row], joints.multipliers[row]
            for c in range(tree.chains.shape[1]):  # those up to itself
                before = tree.chains[i, c]
                psi, of_a, earlier = made.changes[before, :6], made.changes[before, 6:], places.twists[before]
                there, both = joints.sources[before], share * joints.multipliers[before]
                by[0, here, there] += both * (
                    _dot(inertial, of_a) + turned[0] * psi[3] + turned[1] * psi[4] + turned[2] * psi[5]
                )
                by[1, here, there] += both * (
                    2.0 * _dot(inertial, psi) + turned[0] * earlier[3] + turned[1] * earlier[4] + turned[2] * earlier[5]
                )
                mass = both * _dot(inertial, earlier)
                by[2, here, there] += mass
                if before == row:
                    break
                by[0, there, here] += both * _dot(earlier, made.wrenches[row, 9:15])
                by[1, there, here] += both * _dot(earlier, made.wrenches[row, 15:21])
                by[2, there, here] += mass


@uncounted
def write_sample(points: Floats, piece: int, step: float, bases: Floats, state: CoordinateBounds) -> None:
    """Write point, velocity and acceleration at a sample of a piece, by the bases (3, 4) there."""
    for j in range(points.shape[1]):
        z = dz = ddz = 0.0
        for a in range(4):
            z += bases[0, a] * points[piece + a, j]
            dz += bases[1, a] * points[piece + a, j]
            ddz += bases[2, a] * points[piece + a, j]
        state.z[j], state.dz[j], state.ddz[j] = z, dz / step, ddz / (step * step)


@kernel
def largest_torque_loads(
    tree: MassTree, limits: Row, points: Rows, step: float, bases: Blocks, share: float, loads_out: RowOut
) -> float:
    """Write the largest load at each sample, shape (pieces samples,); return the sum of squares beyond a share.

    The sum has to be that in `load_penalty`, which is what is minimized; so has that of `largest_speed_loads`.

    Args:
        tree: The bodies.
        limits: Of each coordinate, shape (nv,), infinite where there is none [N m or N].
        points: Control points, shape (n, nv).
        step: Length of pieces [s].
        bases: Of samples on a piece of length 1, shape (s, 3, 4).
        share: Of limits.
        loads_out: Of the samples of each piece, one after the other.
    """
    nv, m, pieces = points.shape[1], tree.joints.sources.shape[0], points.shape[0] - 3
    n, chain = tree.joints.table.parents.shape[0], tree.chains.shape[1]
    places, state, buffers = joint_places(tree.joints), empty_bounds(nv, m), allocate_torque_buffers(n, nv, chain)
    total = 0.0
    for at in range(pieces * bases.shape[0]):
        write_sample(points, at // bases.shape[0], step, bases[at % bases.shape[0]], state)
        place_tree(tree, state, places)
        write_torques(tree, state, places, buffers, buffers.torques)
        loads_out[at] = 0.0
        for j in range(nv):
            load = abs(buffers.torques[j]) / limits[j]
            loads_out[at] = max(loads_out[at], load)
            total += max(load - share, 0.0) ** 2
    return total


@kernel
def expand_torque_loads(
    tree: MassTree,
    limits: Row,
    points: Rows,
    step: float,
    bases: Blocks,
    loads: Row,
    near: float,
    pieces_out: IndicesOut,
    samples_out: IndicesOut,
    values_out: RowOut,
    slopes_out: BlocksOut,
) -> int:
    """Expand loads above a share linearly; return how many there are.

    Args:
        tree, limits, points, step, bases: As of `largest_torque_loads`.
        loads: The largest at each sample.
        near: The share.
        pieces_out, samples_out, values_out, slopes_out: As in `LoadModel`, long enough for all loads.
    """
    nv, m, count = points.shape[1], tree.joints.sources.shape[0], 0
    n, chain = tree.joints.table.parents.shape[0], tree.chains.shape[1]
    places, state, buffers = joint_places(tree.joints), empty_bounds(nv, m), allocate_torque_buffers(n, nv, chain)
    made = allocate_derivative_buffers(n, m, nv)
    for at in range(loads.shape[0]):
        if loads[at] <= near:
            continue
        write_sample(points, at // bases.shape[0], step, bases[at % bases.shape[0]], state)
        place_tree(tree, state, places)
        write_torques(tree, state, places, buffers, buffers.torques)
        write_torque_derivatives(tree, state, places, buffers, made)
        for j in range(nv):
            load = buffers.torques[j] / limits[j]
            if abs(load) <= near:
                continue
            pieces_out[count], samples_out[count] = at // bases.shape[0], at % bases.shape[0]
            rest = load
            for p in range(nv):
                for order in range(3):
                    slopes_out[count, order, p] = made.by[order, j, p] / limits[j]
                rest -= slopes_out[count, 0, p] * state.z[p] + slopes_out[count, 1, p] * state.dz[p]
                rest -= slopes_out[count, 2, p] * state.ddz[p]
            values_out[count] = rest
            count += 1
    return count


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
    """Write the load at each sample; return the sum of squares beyond a share, as `largest_torque_loads` does."""
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

    See `expand_torque_loads`. Where points are balls their turning counts as if the velocity were longer:
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
