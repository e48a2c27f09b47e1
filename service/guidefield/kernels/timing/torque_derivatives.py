"""Derivatives of torques by coordinates, velocities and accelerations: for expansions by `torque_loads`.

The optimizer alone goes by them: with wrong ones it finds worse motions, while limits of torques are kept all the same.

With S_j the twist of coordinate j in the world, v and a the twist and its derivative before it, let

    ψ_j = v x S_j        A_j = a x S_j + v x ψ_j

A body's wrench Y a' + v' x* Y v' then changes by Y A_j + D ψ_j with coordinate j, in axes that j moves along, by
2 Y ψ_j + D S_j with its velocity, and by Y S_j with its acceleration, where j moves the body, and

    D ψ = v' x* Y ψ - Y (v' x ψ) + ψ x* Y v'

keeps three numbers and a matrix of nine. Sums of Y and D over what a joint carries give the torque's. Source:
J. Carpentier and N. Mansard, "Analytical derivatives of rigid body dynamics algorithms", Robotics: Science and Systems
XIV, 2018.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from guidefield.kernels.jit.arrays import BlocksOut, Floats, RowsOut, Vector3
from guidefield.kernels.jit.decorators import counted, uncounted
from guidefield.kernels.kinematics.forward_kinematics import JointPlaces
from guidefield.kernels.kinematics.poses import moved_by
from guidefield.kernels.timing.carried_rates import CoordinateBounds
from guidefield.kernels.timing.torques import MassTree, TorqueRoom

MASS, MOMENT, INERTIA, MOMENTUM, TURNING = 0, 1, 4, 10, 13  # columns of `DerivativeRoom.carried`
CARRIED = 22  # their number


class DerivativeRoom(NamedTuple):
    """Scratch: of joints what they carry; of coordinates ψ and A, and their wrenches and those of S."""

    carried: RowsOut  # shape (n, CARRIED): mass, its first and second moments, momentum, and the matrix of D
    changes: RowsOut  # ψ, A, shape (m, 12)
    wrenches: RowsOut  # Y S, D's transpose of S; Y A + D ψ + S x* F; 2 Y ψ + D S, shape (m, 21)
    before: RowsOut  # a twist and its derivative, shape (2, 6)
    by: BlocksOut  # the derivatives [order, torque, coordinate], shape (3, nv, nv)


@counted
def derivative_room(n: int, m: int, nv: int) -> DerivativeRoom:
    """Return scratch for n joints, m coordinates of the model, nv of the group."""
    scratch = np.empty((n, CARRIED)), np.empty((m, 12)), np.empty((m, 21)), np.empty((2, 6))
    return DerivativeRoom(scratch[0], scratch[1], scratch[2], scratch[3], np.empty((3, nv, nv)))


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
    row: int, carried: Floats, places: JointPlaces, twist: Floats, change: Floats, force: Floats, room: DerivativeRoom
) -> None:
    """Write ψ, A and the wrenches of a coordinate, by twist and change before it, and the wrench that it carries."""
    s, psi, of_a = places.twists[row], room.changes[row, :6], room.changes[row, 6:]
    _times(twist, s, psi)
    _times(twist, psi, of_a)
    extra = room.wrenches[row, :6]
    _times(change, s, extra)
    for k in range(6):
        of_a[k] += extra[k]
    inertial, turned = room.wrenches[row, :6], room.wrenches[row, 6:9]
    by_point, by_rate = room.wrenches[row, 9:15], room.wrenches[row, 15:21]
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
    tree: MassTree, state: CoordinateBounds, places: JointPlaces, room: TorqueRoom, made: DerivativeRoom
) -> None:
    """Write the derivatives of torques where `torques.write_torques` wrote them."""
    joints, table, by = tree.joints, tree.joints.table, made.by
    _write_carried(tree, places, room.twists, made.carried)
    by[:, :, :] = 0.0
    twist, change = made.before[0], made.before[1]
    for i in range(1, table.parents.shape[0]):
        for k in range(6):
            twist[k], change[k] = room.twists[table.parents[i], k], room.changes[table.parents[i], k]
        for own in range(table.nv[i]):
            row = table.idx_v[i] + own
            _write_coordinate(row, made.carried[i], places, twist, change, room.wrenches[i], made)
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
