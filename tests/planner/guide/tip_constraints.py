"""What constraints of the tip come to, by the parts of kernels."""

from __future__ import annotations

import numpy as np

from guidefield.kernels.guide.tip_constraint import TipConstraint, constraint_error, constraint_rows
from guidefield.kernels.kinematics.forward_kinematics import joint_placements, motion_subspaces
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.kinematics import mover_of


def evaluated(constraint: TipConstraint, group: PlanningGroup, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A constraint's numbers at q (nq,), and their derivative by the tangent (rows, nv)."""
    mover = mover_of(group)
    world, subspaces = np.empty((len(mover.joints.parents), 3, 4)), np.empty((len(mover.leaders), 6))
    error, rows = np.empty(constraint.kind), np.empty((constraint.kind, group.nv))
    joint_placements(mover.joints, group.expand(q), world)
    motion_subspaces(mover.joints, world, subspaces)
    constraint_error(constraint, mover, world, np.zeros(3), error)
    constraint_rows(constraint, mover, world, subspaces, np.empty((6, group.nv)), rows)
    return error, rows
