"""Frames and joints of a Pinocchio model by name, and its joints as tables for the kernels.

Links and joints may share a name, and then the link's frame is meant.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from guidefield.kernels.kinematics.forward_kinematics import (
    CONTINUOUS,
    FLOATING,
    PLANAR,
    PRISMATIC,
    REVOLUTE,
    SPHERICAL,
    JointTable,
)

CODES = {
    "JointModelPlanar": PLANAR,
    "JointModelSpherical": SPHERICAL,
    "JointModelFreeFlyer": FLOATING,
    "JointModelRevoluteUnaligned": REVOLUTE,
    "JointModelRevoluteUnboundedUnaligned": CONTINUOUS,
    "JointModelPrismaticUnaligned": PRISMATIC,
    **{f"JointModelR{axis}": REVOLUTE for axis in "XYZ"},
    **{f"JointModelRUB{axis}": CONTINUOUS for axis in "XYZ"},
    **{f"JointModelP{axis}": PRISMATIC for axis in "XYZ"},
}


def joint_table(model: Any) -> JointTable:
    """Tables of a model's joints, in its order; row 0 is the world."""
    n = model.njoints
    parents, kinds, idx_q, idx_v, nv = (np.zeros(n, np.int64) for _ in range(5))
    axes, placements = np.zeros((n, 3)), np.zeros((n, 3, 4))
    for index in range(1, n):
        joint = model.joints[index]
        short = joint.shortname()
        parents[index], kinds[index] = model.parents[index], CODES[short]
        idx_q[index], idx_v[index], nv[index] = joint.idx_q, joint.idx_v, joint.nv
        axes[index] = axis_of(joint) if joint.nv == 1 else 0.0
        placement: pin.SE3 = model.jointPlacements[index]
        placements[index] = np.c_[placement.rotation, placement.translation]
    for array in (parents, kinds, axes, placements, idx_q, idx_v, nv):
        array.setflags(write=False)
    return JointTable(parents, kinds, axes, placements, idx_q, idx_v, nv)


def axis_of(joint: Any) -> np.ndarray:
    """Axis of a Pinocchio joint with one degree of freedom, shape (3,): where its subspace isn't zero."""
    data = joint.createData()
    joint.calc(data, np.zeros(joint.idx_q + joint.nq))
    subspace = np.asarray(data.S, float).ravel()
    axis: np.ndarray = subspace[:3] if np.any(subspace[:3]) else subspace[3:]
    return axis


def joint_indices(model: Any) -> dict[str, int]:
    """Return Pinocchio's index of each joint by name, but of the world, which it calls `universe`."""
    return {name: index for index, name in enumerate(model.names) if index}


def frame_index(model: Any, name: str) -> int | None:
    """Pinocchio's index of a link's frame, else of any other frame of that name; None if there is none."""
    if model.existFrame(name, pin.FrameType.BODY):
        return int(model.getFrameId(name, pin.FrameType.BODY))
    for index, frame in enumerate(model.frames):
        if frame.name == name and index:
            return index
    return None


def moving_joint(model: Any, name: str) -> int:
    """Index of the joint that moves a frame; 0 if it stands still or there is none of that name."""
    index = frame_index(model, name)
    return 0 if index is None else int(model.frames[index].parentJoint)


def joints_to(model: Any, frame: str) -> list[str]:
    """Names of the joints between the root and a frame, from the root on."""
    return [model.names[index] for index in model.supports[moving_joint(model, frame)] if index]
