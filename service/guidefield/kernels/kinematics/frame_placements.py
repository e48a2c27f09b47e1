"""Placements of frames at many configurations."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import void

from guidefield.kernels.jit.fields import Blocks, Indices, numba_type
from guidefield.kernels.jit.signatures import BLOCKS_OUT, MATRIX, Floats, compiled
from guidefield.kernels.kinematics.forward_kinematics import JOINTS, JointTable, compose, place_joints, quaternion_of


class FrameTable(NamedTuple):
    """Frames of a robot.

    Attributes:
        joints: The joint that carries each frame, by its row in `JointTable`, shape (k,).
        placements: Rotation and translation of each frame in that of its joint, shape (k, 3, 4) [m].
    """

    joints: Indices
    placements: Blocks


@compiled(void(JOINTS, numba_type(FrameTable), MATRIX, MATRIX, BLOCKS_OUT))
def place_frames(
    joints: JointTable, frames: FrameTable, root: Floats, configurations: Floats, placements_out: Floats
) -> None:
    """Place frames at configurations.

    Args:
        joints: All joints of the robot.
        frames: The frames.
        root: Placement of the robot's root in the world, shape (3, 4) [m].
        configurations: Shape (n, nq).
        placements_out: Position [m] and unit quaternion (x, y, z, w) of each frame in the world, shape (n, k, 7).
    """
    rotation, translation, poses = np.empty((3, 3)), np.empty(3), np.empty((joints.parents.shape[0], 3, 4))
    placed = np.empty((3, 4))
    for i in range(configurations.shape[0]):
        place_joints(
            joints.parents, joints.kinds, joints.axes, joints.placements, joints.idx_q, configurations[i], rotation,
            translation, poses,
        )  # fmt: skip
        for k in range(frames.joints.shape[0]):
            frame, out = frames.placements[k], placements_out[i, k]
            compose(root, poses[frames.joints[k]], frame[:, :3], frame[:, 3], placed)
            for r in range(3):
                out[r] = placed[r, 3]
            quaternion_of(placed, out, 3)
