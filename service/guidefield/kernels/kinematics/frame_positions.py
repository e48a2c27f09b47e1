"""Where a frame is along many chart points."""

from __future__ import annotations

import numpy as np
from numba import types, void

from guidefield.kernels.jit.signatures import MATRIX, MATRIX_OUT, VECTOR, Floats, compiled
from guidefield.kernels.kinematics.chart import configuration
from guidefield.kernels.kinematics.forward_kinematics import JOINTS, JointTable, joint_placements
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
