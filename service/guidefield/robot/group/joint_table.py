"""The joints of a planning group as a table for the kernels."""

from __future__ import annotations

import numpy as np

from guidefield.kernels.kinematics.forward_kinematics import JointTable
from guidefield.read_only import read_only
from guidefield.robot.group.alike import memoized_for_alike
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.model.joint_tables import joint_table


@memoized_for_alike
def joints_of(group: PlanningGroup) -> JointTable:
    """Tables of the joints of a group's model; made once."""
    return joint_table(group.model)


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
