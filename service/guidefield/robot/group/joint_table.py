"""The joints of a planning group as a table for the kernels."""

from __future__ import annotations

import numpy as np

from guidefield.kernels.kinematics.forward_kinematics import JointTable
from guidefield.kernels.kinematics.group_joints import GroupJoints
from guidefield.read_only import read_only
from guidefield.robot.group.alike import memoized_for_alike
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.model.joint_tables import joint_table


@memoized_for_alike
def joints_of(group: PlanningGroup) -> JointTable:
    """Tables of the joints of a group's model; made once."""
    return joint_table(group.model)


def group_joints(group: PlanningGroup) -> GroupJoints:
    """Tables of a group's joints and of the local coordinates that move them."""
    origin = np.array(group.expand(group.q_origin), float)
    origin.setflags(write=False)
    return alike_group_joints(group)._replace(origin=origin)


@memoized_for_alike
def alike_group_joints(group: PlanningGroup) -> GroupJoints:
    """The same, but for the origin of rotation vectors; made once."""
    expand = group.expand_velocity
    sources, multipliers = np.abs(expand).argmax(axis=1), expand.sum(axis=1)
    assert (np.count_nonzero(expand, axis=1) <= 1).all(), "a joint follows at most one coordinate"
    joints = GroupJoints(joints_of(group), sources, multipliers, np.array(group.expand_offset, float), np.empty(0))
    read_only(*joints[1:])
    return joints


def chain_of(joints: JointTable, last: int) -> JointTable:
    """The joints from the world to one of a table, which is the last: all that decide where it is."""
    rows = [last]
    while rows[0] > 0:
        rows.insert(0, int(joints.parents[rows[0]]))
    parents = np.maximum(np.arange(len(rows)) - 1, 0)
    chain = JointTable(
        parents,
        joints.kinds[rows],
        joints.axes[rows],
        joints.placements[rows],
        joints.idx_q[rows],
        joints.idx_v[rows],
        joints.nv[rows],
    )
    read_only(*chain)
    return chain
