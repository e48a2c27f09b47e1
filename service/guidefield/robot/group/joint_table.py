"""The joints of a planning group as a table for the kernels."""

from __future__ import annotations

from guidefield.kernels.kinematics.forward_kinematics import JointTable
from guidefield.robot.group.alike import kept_with_alike
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.model.joint_tables import joint_table


@kept_with_alike
def joints_of(group: PlanningGroup) -> JointTable:
    """Tables of the joints of a group's model; made once."""
    return joint_table(group.model)
