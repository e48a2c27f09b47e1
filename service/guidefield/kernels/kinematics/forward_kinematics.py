"""Forward kinematics of a tree of joints in float64, and its derivatives, from tables: one kernel for every robot.

Joint kinds and their motion subspaces are Pinocchio's (linear part first): a revolute or continuous joint turns about
its axis, a prismatic one slides along it, a planar one moves in its x-y plane and turns about z, a spherical one turns
freely, a floating one does everything; the last three have tangents in the moved frame. Configurations have a cosine
and sine for a continuous joint, quaternions are (x, y, z, w). Local coordinates of a spherical or floating joint are
rotation vectors from a configuration `origin`. `robot/model/model.py` makes the table. Planning, proofs and replies
place robots by it, and the referee by code of its own.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from guidefield.kernels.jit.arrays import (
    Blocks,
    BlocksOut,
    Floats,
    Indices,
    Row,
    RowOut,
    Rows,
    RowsOut,
    Vector3,
    numba_type,
)
from guidefield.kernels.jit.decorators import counted, inlined, kernel, uncounted
from guidefield.kernels.kinematics.poses import moved_by

REVOLUTE, CONTINUOUS, PRISMATIC, PLANAR, SPHERICAL, FLOATING = range(6)  # codes of joint kinds in `JointTable.kinds`


class JointTable(NamedTuple):
    """The joints of a tree, parents before children; row 0 is the world."""

    parents: Indices  # index of each joint's parent, shape (n,)
    kinds: Indices  # code of what it can do, shape (n,)
    axes: Rows  # its axis in its own frame, shape (n, 3)
    placements: Blocks  # rotation and translation of the joint frame in the parent's, shape (n, 3, 4) [m]
    # idx_q, idx_v, nv: Where its values stand, and how many tangent values it has, each of shape (n,)
    idx_q: Indices
    idx_v: Indices
    nv: Indices


JOINTS = numba_type(JointTable)


@inlined
def axis_rotation(ax: float, ay: float, az: float, c: float, s: float, rotation_out: Floats) -> None:
    """Write the rotation (3, 3) about a unit axis by an angle of cosine c and sine s (Rodrigues)."""
    d = 1.0 - c
    rotation_out[0, 0] = c + ax * ax * d
    rotation_out[0, 1] = ax * ay * d - az * s
    rotation_out[0, 2] = ax * az * d + ay * s
    rotation_out[1, 0] = ay * ax * d + az * s
    rotation_out[1, 1] = c + ay * ay * d
    rotation_out[1, 2] = ay * az * d - ax * s
    rotation_out[2, 0] = az * ax * d - ay * s
    rotation_out[2, 1] = az * ay * d + ax * s
    rotation_out[2, 2] = c + az * az * d


@inlined
def _quaternion_rotation(x: float, y: float, z: float, w: float, rotation_out: Floats) -> None:
    rotation_out[0, 0] = 1.0 - 2.0 * (y * y + z * z)
    rotation_out[0, 1] = 2.0 * (x * y - z * w)
    rotation_out[0, 2] = 2.0 * (x * z + y * w)
    rotation_out[1, 0] = 2.0 * (x * y + z * w)
    rotation_out[1, 1] = 1.0 - 2.0 * (x * x + z * z)
    rotation_out[1, 2] = 2.0 * (y * z - x * w)
    rotation_out[2, 0] = 2.0 * (x * z - y * w)
    rotation_out[2, 1] = 2.0 * (y * z + x * w)
    rotation_out[2, 2] = 1.0 - 2.0 * (x * x + y * y)


@inlined
def quaternion_of(R: Floats, q_out: Floats, at: int) -> None:
    """Write the unit quaternion (x, y, z, w) of a rotation (3, 3), or of a placement (3, 4), to `q_out[at:]`.

    As Eigen does: from w where that is the safe one, else from the largest of the others (Shepperd 1978).
    """
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    if trace > 0.0:
        s = 2.0 * math.sqrt(1.0 + trace)
        x, y, z, w = (R[2, 1] - R[1, 2]) / s, (R[0, 2] - R[2, 0]) / s, (R[1, 0] - R[0, 1]) / s, 0.25 * s
    elif R[0, 0] >= R[1, 1] and R[0, 0] >= R[2, 2]:
        s = 2.0 * math.sqrt(1.0 + R[0, 0] - R[1, 1] - R[2, 2])
        x, y, z, w = 0.25 * s, (R[0, 1] + R[1, 0]) / s, (R[0, 2] + R[2, 0]) / s, (R[2, 1] - R[1, 2]) / s
    elif R[1, 1] >= R[2, 2]:
        s = 2.0 * math.sqrt(1.0 + R[1, 1] - R[0, 0] - R[2, 2])
        x, y, z, w = (R[0, 1] + R[1, 0]) / s, 0.25 * s, (R[1, 2] + R[2, 1]) / s, (R[0, 2] - R[2, 0]) / s
    else:
        s = 2.0 * math.sqrt(1.0 + R[2, 2] - R[0, 0] - R[1, 1])
        x, y, z, w = (R[0, 2] + R[2, 0]) / s, (R[1, 2] + R[2, 1]) / s, 0.25 * s, (R[1, 0] - R[0, 1]) / s
    over = 1.0 / math.sqrt(x * x + y * y + z * z + w * w)
    q_out[at], q_out[at + 1], q_out[at + 2], q_out[at + 3] = over * x, over * y, over * z, over * w


@inlined
def compose(parent: Floats, fixed: Floats, rotation: Floats, translation: Floats, placement_out: Floats) -> None:
    """Write the product of placements: parent * fixed * (rotation, translation), shapes (3, 4), (3, 3) and (3,)."""
    for r in range(3):
        r0 = parent[r, 0] * fixed[0, 0] + parent[r, 1] * fixed[1, 0] + parent[r, 2] * fixed[2, 0]
        r1 = parent[r, 0] * fixed[0, 1] + parent[r, 1] * fixed[1, 1] + parent[r, 2] * fixed[2, 1]
        r2 = parent[r, 0] * fixed[0, 2] + parent[r, 1] * fixed[1, 2] + parent[r, 2] * fixed[2, 2]
        t = parent[r, 3] + parent[r, 0] * fixed[0, 3] + parent[r, 1] * fixed[1, 3] + parent[r, 2] * fixed[2, 3]
        placement_out[r, 0] = r0 * rotation[0, 0] + r1 * rotation[1, 0] + r2 * rotation[2, 0]
        placement_out[r, 1] = r0 * rotation[0, 1] + r1 * rotation[1, 1] + r2 * rotation[2, 1]
        placement_out[r, 2] = r0 * rotation[0, 2] + r1 * rotation[1, 2] + r2 * rotation[2, 2]
        placement_out[r, 3] = t + r0 * translation[0] + r1 * translation[1] + r2 * translation[2]


@uncounted
def place_joints(joints: JointTable, q: Floats, rotation: Floats, translation: Floats, placements_out: Floats) -> None:
    """`joint_placements` with scratch of shapes (3, 3) and (3,), for kernels that place joints again and again."""
    parents, kinds, axes, placements, idx_q, _, _ = joints
    for r in range(3):
        for c in range(4):
            placements_out[0, r, c] = 1.0 if r == c else 0.0
    for i in range(1, parents.shape[0]):
        at = idx_q[i]
        translation[:] = 0.0
        kind = kinds[i]
        if kind == PRISMATIC:
            rotation[:, :] = 0.0
            for k in range(3):
                rotation[k, k] = 1.0
                translation[k] = axes[i, k] * q[at]
        elif kind == REVOLUTE:
            axis_rotation(axes[i, 0], axes[i, 1], axes[i, 2], math.cos(q[at]), math.sin(q[at]), rotation)
        elif kind == CONTINUOUS:
            axis_rotation(axes[i, 0], axes[i, 1], axes[i, 2], q[at], q[at + 1], rotation)
        elif kind == PLANAR:
            translation[0] = q[at]
            translation[1] = q[at + 1]
            axis_rotation(0.0, 0.0, 1.0, q[at + 2], q[at + 3], rotation)
        elif kind == SPHERICAL:
            _quaternion_rotation(q[at], q[at + 1], q[at + 2], q[at + 3], rotation)
        else:
            for k in range(3):
                translation[k] = q[at + k]
            _quaternion_rotation(q[at + 3], q[at + 4], q[at + 5], q[at + 6], rotation)
        compose(placements_out[parents[i]], placements[i], rotation, translation, placements_out[i])


@kernel
def joint_placements(joints: JointTable, q: Row, placements_out: BlocksOut) -> None:
    """Write the world placement (n, 3, 4) [m] of every joint's moved frame at a configuration (nq,).

    T_world_i = T_world_parent T_parent_joint T_joint(q_i); row 0 is the world itself.
    """
    place_joints(joints, q, np.empty((3, 3)), np.empty(3), placements_out)


@uncounted
def place_subspaces(joints: JointTable, placements: Floats, subspaces_out: Floats) -> None:
    """`motion_subspaces` within kernels."""
    _, kinds, axes, _, _, idx_v, nv = joints
    for i in range(1, kinds.shape[0]):
        for k in range(nv[i]):
            row = idx_v[i] + k
            lx, ly, lz, wx, wy, wz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            kind = kinds[i]
            if kind in (REVOLUTE, CONTINUOUS):
                wx, wy, wz = axes[i, 0], axes[i, 1], axes[i, 2]
            elif kind == PRISMATIC:
                lx, ly, lz = axes[i, 0], axes[i, 1], axes[i, 2]
            else:
                code = k
                if kind == PLANAR and k == 2:
                    code = 5
                if kind == SPHERICAL:
                    code = 3 + k
                lx, ly, lz = 1.0 * (code == 0), 1.0 * (code == 1), 1.0 * (code == 2)
                wx, wy, wz = 1.0 * (code == 3), 1.0 * (code == 4), 1.0 * (code == 5)
            T = placements[i]
            ax = T[0, 0] * wx + T[0, 1] * wy + T[0, 2] * wz
            ay = T[1, 0] * wx + T[1, 1] * wy + T[1, 2] * wz
            az = T[2, 0] * wx + T[2, 1] * wy + T[2, 2] * wz
            # velocity at the world's origin = rotated linear part - omega x t = linear + t x omega
            subspaces_out[row, 0] = T[0, 0] * lx + T[0, 1] * ly + T[0, 2] * lz + T[1, 3] * az - T[2, 3] * ay
            subspaces_out[row, 1] = T[1, 0] * lx + T[1, 1] * ly + T[1, 2] * lz + T[2, 3] * ax - T[0, 3] * az
            subspaces_out[row, 2] = T[2, 0] * lx + T[2, 1] * ly + T[2, 2] * lz + T[0, 3] * ay - T[1, 3] * ax
            subspaces_out[row, 3] = ax
            subspaces_out[row, 4] = ay
            subspaces_out[row, 5] = az


@kernel
def motion_subspaces(joints: JointTable, placements: BlocksOut, subspaces_out: RowsOut) -> None:
    """Write the twist (total nv, 6) of each tangent value, at the world's origin in its axes, linear part first.

    `placements` (n, 3, 4) are those of `joint_placements`.
    """
    place_subspaces(joints, placements, subspaces_out)


_SMALL = 1e-4  # below this angle series stand for sine and cosine [rad]: off by less than rounding; less loses digits


@inlined
def configuration(joints: JointTable, values: Floats, origin: Floats, q_out: Floats) -> None:
    """Write the configuration (nq,) of local coordinates (nv,); rotation vectors start from `origin` (nq,)."""
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
def place_by_local(
    joints: JointTable,
    values: Floats,
    origin: Floats,
    q_out: Floats,
    rotation: Floats,
    translation: Floats,
    poses_out: Floats,
) -> None:
    """Place joints (n, 3, 4) [m] at local coordinates, as `configuration` takes them; scratch (3, 3) and (3,)."""
    configuration(joints, values, origin, q_out)
    place_joints(joints, q_out, rotation, translation, poses_out)


@inlined
def subspaces_by_local(joints: JointTable, values: Floats, q: Floats, subspaces_out: Floats) -> None:
    """Replace rows of `motion_subspaces` (nv, 6) by those that local velocities cause: M^T S.

    At local coordinates `values` (nv,) of the configuration q (nq,).
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
    """Write the quaternion (x, y, z, w) at an index of `origin` (nq,) turned by a rotation vector in its own frame."""
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


_TURN = 2.0 * math.pi


@inlined
def _near_angle(angle: float, near: float) -> float:
    return angle + _TURN * math.floor((near - angle) / _TURN + 0.5)


@inlined
def _rotation_vector(q: Floats, origin: Floats, at: int, near: Floats, v: int, values_out: Floats) -> None:
    """Write the rotation vector from `origin`'s quaternion to q's, the short or the long one: the nearer to `near`."""
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


@kernel
def local_values(joints: JointTable, q: Row, origin: Row, near: Row, values_out: RowOut) -> None:
    """Write the local coordinates (nv,) of a configuration (nq,) that are nearest to others, `near` (nv,).

    Rotation vectors start from the configuration `origin` (nq,).
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


class GroupJoints(NamedTuple):
    """The joints of a robot's model, and the local coordinates z of a group that move them."""

    table: JointTable  # the joints, mimic joints included
    # sources, multipliers, offsets: Local coordinate i of the model is multipliers[i] z[sources[i]] + offsets[i]
    # [rad or m]; each of shape (m,)
    sources: Indices
    multipliers: Row
    offsets: Row
    origin: Row  # configuration of the model from which rotation vectors start, shape (nq,)


class JointPlaces(NamedTuple):
    """Placements of a group's joints and scratch to find them; n joints, m local coordinates of the model."""

    values: RowOut  # local coordinates of the model, shape (m,) [rad or m]
    q: RowOut  # configuration of the model, shape (nq,)
    # rotation, translation: Of one joint by its value, shapes (3, 3) and (3,)
    rotation: RowsOut
    translation: RowOut
    poses: BlocksOut  # placements of the joints in the world, shape (n, 3, 4) [m]
    # linear velocity of the point at the world's origin, then angular velocity, by each local coordinate of the model,
    # shape (m, 6)
    twists: RowsOut


@counted
def joint_places(joints: GroupJoints) -> JointPlaces:
    """Scratch for placements of a group's joints."""
    n, m = joints.table.parents.shape[0], joints.offsets.shape[0]
    nq = joints.origin.shape[0]
    return JointPlaces(np.empty(m), np.empty(nq), np.empty((3, 3)), np.empty(3), np.empty((n, 3, 4)), np.empty((m, 6)))


@uncounted
def place_group(joints: GroupJoints, z: Floats, places: JointPlaces) -> None:
    """Place the joints at local coordinates of the group, shape (nv,) [rad or m]."""
    for i in range(joints.offsets.shape[0]):
        places.values[i] = joints.multipliers[i] * z[joints.sources[i]] + joints.offsets[i]
    place_by_local(
        joints.table, places.values, joints.origin, places.q, places.rotation, places.translation, places.poses
    )


@uncounted
def write_twists(joints: GroupJoints, places: JointPlaces) -> None:
    """Write how the model's local coordinates move the joints where they were placed last."""
    place_subspaces(joints.table, places.poses, places.twists)
    subspaces_by_local(joints.table, places.values, places.q, places.twists)


@uncounted
def velocity_by(twist: Floats, x: float, y: float, z: float) -> Vector3:
    """Return the velocity of a point by a twist (v, w) at the world's origin, shape (6,): v + w x p.

    Its length is the distance from the axis of a joint that turns, and 1 of one that slides.
    """
    return (
        twist[0] + twist[4] * z - twist[5] * y,
        twist[1] + twist[5] * x - twist[3] * z,
        twist[2] + twist[3] * y - twist[4] * x,
    )


class CarriedPoint(NamedTuple):
    """A point that a joint carries."""

    joints: GroupJoints  # the joints; those that don't lead to the parent joint may be left out
    parent_joint: int  # the joint that carries it, by its row
    point: Row  # in its frame, shape (3,) [m]


@uncounted
def place_point(of: CarriedPoint, z: Floats, places: JointPlaces) -> Vector3:
    """Position of a point at local coordinates of the group, shape (nv,) [m]; leaves the joints' placements."""
    place_group(of.joints, z, places)
    return moved_by(places.poses[of.parent_joint], of.point[0], of.point[1], of.point[2])


@kernel
def frame_positions(of: CarriedPoint, zs: Rows, positions_out: RowsOut) -> None:
    """Write the positions (k, 3) of a point that a joint carries, at local coordinates (k, nv) [m, world]."""
    places = joint_places(of.joints)
    for k in range(zs.shape[0]):
        x, y, z = place_point(of, zs[k], places)
        positions_out[k, 0], positions_out[k, 1], positions_out[k, 2] = x, y, z


@kernel
def frame_slopes(of: CarriedPoint, z: Row, slopes_out: RowsOut) -> None:
    """Write the derivative (3, nv) of a carried point's position by local coordinates (nv,) [m per rad or m, world].

    A twist (v, w) at the world's origin moves the point p by v + w x p.
    """
    joints, table, places = of.joints, of.joints.table, joint_places(of.joints)
    px, py, pz = place_point(of, z, places)
    write_twists(joints, places)
    slopes_out[:, :] = 0.0
    joint = of.parent_joint
    while joint > 0:
        for row in range(table.idx_v[joint], table.idx_v[joint] + table.nv[joint]):
            column, by = joints.sources[row], joints.multipliers[row]
            vx, vy, vz = velocity_by(places.twists[row], px, py, pz)
            slopes_out[0, column] += by * vx
            slopes_out[1, column] += by * vy
            slopes_out[2, column] += by * vz
        joint = table.parents[joint]


class FrameTable(NamedTuple):
    """Frames of a robot."""

    joints: Indices  # the joint that carries each frame, by its row in `JointTable`, shape (k,)
    placements: Blocks  # rotation and translation of each frame in that of its joint, shape (k, 3, 4) [m]


@kernel
def place_frames(
    joints: JointTable, frames: FrameTable, root: Rows, configurations: Rows, placements_out: BlocksOut
) -> None:
    """Write position [m] and quaternion (x, y, z, w) of frames at configurations (n, nq), shape (n, k, 7).

    `root` (3, 4) is the placement of the robot's root in the world.
    """
    rotation, translation, poses = np.empty((3, 3)), np.empty(3), np.empty((joints.parents.shape[0], 3, 4))
    placed = np.empty((3, 4))
    for i in range(configurations.shape[0]):
        place_joints(joints, configurations[i], rotation, translation, poses)
        for k in range(frames.joints.shape[0]):
            frame, out = frames.placements[k], placements_out[i, k]
            compose(root, poses[frames.joints[k]], frame[:, :3], frame[:, 3], placed)
            for r in range(3):
                out[r] = placed[r, 3]
            quaternion_of(placed, out, 3)
