"""Where a frame is at chart points, and how it moves with them."""

from __future__ import annotations

import numpy as np
from numba import types, void

from guidefield.kernels.jit.signatures import MATRIX, MATRIX_OUT, VECTOR, Floats, compiled
from guidefield.kernels.kinematics.chart import configuration, subspaces_by_chart
from guidefield.kernels.kinematics.forward_kinematics import JOINTS, JointTable, joint_placements, place_subspaces
from guidefield.kernels.kinematics.poses import moved_by


@compiled(void(JOINTS, MATRIX, VECTOR, VECTOR, MATRIX, types.int64, VECTOR, MATRIX_OUT))
def frame_positions(
    joints: JointTable,
    expand: Floats,
    offset: Floats,
    origin: Floats,
    zs: Floats,
    carrier: int,
    point: Floats,
    positions_out: Floats,
) -> None:
    """Positions of a point that a joint carries.

    Args:
        joints: Joints of the model, followers included.
        expand: Coordinates of the model's chart by those of the group, shape (n, nv); with `offset`.
        offset: Shape (n,) [rad or m].
        origin: Configuration of the model from which rotation vectors start, shape (nq,).
        zs: Chart points of the group, shape (k, nv) [rad or m].
        carrier: The joint.
        point: In its frame, shape (3,) [m].
        positions_out: Shape (k, 3) [m, world].
    """
    values, q = np.empty(offset.shape[0]), np.empty(origin.shape[0])
    poses = np.empty((joints.parents.shape[0], 3, 4))
    for k in range(zs.shape[0]):
        for i in range(values.shape[0]):
            values[i] = offset[i]
            for j in range(zs.shape[1]):
                values[i] += expand[i, j] * zs[k, j]
        configuration(joints, values, origin, q)
        joint_placements(joints.parents, joints.kinds, joints.axes, joints.placements, joints.idx_q, q, poses)
        x, y, z = moved_by(poses[carrier], point[0], point[1], point[2])
        positions_out[k, 0], positions_out[k, 1], positions_out[k, 2] = x, y, z


@compiled(void(JOINTS, MATRIX, VECTOR, VECTOR, VECTOR, types.int64, VECTOR, MATRIX_OUT))
def frame_slopes(
    joints: JointTable,
    expand: Floats,
    offset: Floats,
    origin: Floats,
    z: Floats,
    carrier: int,
    point: Floats,
    slopes_out: Floats,
) -> None:
    """Derivative by the chart of the position of a point that a joint carries.

    A twist (v, w) at the world's origin moves the point p by v + w x p.

    Args:
        joints: Joints of the model, followers included.
        expand: As in `frame_positions`.
        offset: See there.
        origin: See there.
        z: Chart point of the group, shape (nv,) [rad or m].
        carrier: The joint.
        point: In its frame, shape (3,) [m].
        slopes_out: Shape (3, nv) [m per rad or m, world].
    """
    values, q = np.empty(offset.shape[0]), np.empty(origin.shape[0])
    poses, subspaces = np.empty((joints.parents.shape[0], 3, 4)), np.empty((offset.shape[0], 6))
    for i in range(values.shape[0]):
        values[i] = offset[i]
        for j in range(z.shape[0]):
            values[i] += expand[i, j] * z[j]
    configuration(joints, values, origin, q)
    joint_placements(joints.parents, joints.kinds, joints.axes, joints.placements, joints.idx_q, q, poses)
    place_subspaces(joints.kinds, joints.axes, joints.idx_v, joints.nv, poses, subspaces)
    subspaces_by_chart(joints, values, q, subspaces)
    px, py, pz = moved_by(poses[carrier], point[0], point[1], point[2])
    slopes_out[:, :] = 0.0
    joint = carrier
    while joint > 0:
        for row in range(joints.idx_v[joint], joints.idx_v[joint] + joints.nv[joint]):
            twist = subspaces[row]
            vx, vy, vz, wx, wy, wz = twist[0], twist[1], twist[2], twist[3], twist[4], twist[5]
            dx, dy, dz = vx + wy * pz - wz * py, vy + wz * px - wx * pz, vz + wx * py - wy * px
            for j in range(z.shape[0]):
                slopes_out[0, j] += expand[row, j] * dx
                slopes_out[1, j] += expand[row, j] * dy
                slopes_out[2, j] += expand[row, j] * dz
        joint = joints.parents[joint]
