"""Forward kinematics of a planning group: placements and Jacobians of its frames."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin

from guidefield.kernels.kinematics.group_joints import CarriedPoint, frame_positions, frame_slopes
from guidefield.read_only import read_only
from guidefield.robot.group.alike import memoized_for_alike
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.joint_table import alike_group_joints, chain_of, group_joints
from guidefield.robot.group.lent_data import lent_data
from guidefield.robot.model.spaces import ChartPoint, ChartPoints, ModelConfiguration


class Kinematics:
    """Placements and Jacobians of one group; owns the scratch data that Pinocchio needs (one per thread).

    Configurations are those of the group's model: `PlanningGroup.expand` and `expand_from_chart` lead there.
    """

    def __init__(self, group: PlanningGroup) -> None:
        self.group = group

    @cached_property
    def _data(self) -> Any:
        return lent_data(self.group, self)

    def frame_placement(self, q: ModelConfiguration, frame_id: int) -> Any:
        """Where a frame is.

        Args:
            q: Configuration of `group.model`, shape (model.nq,).
            frame_id: Index of a frame of `group.model`.

        Returns:
            ``T_world_frame``, a pinocchio.SE3 of its own [m].
        """
        model = self.group.model
        pin.forwardKinematics(model, self._data, q)
        return pin.updateFramePlacement(model, self._data, frame_id).copy()

    def tip_position(self, q: ModelConfiguration) -> np.ndarray:
        """Position of the tip in the world, shape (3,) [m], at a configuration of `group.model`, shape (model.nq,)."""
        position: np.ndarray = self.frame_placement(q, self.group.tip_id).translation
        return position

    def tip_positions(self, zs: ChartPoints) -> np.ndarray:
        """Positions of the tip in the world, shape (k, 3) [m], at chart points of the group, shape (k, nv)."""
        positions = np.empty((len(zs), 3))
        frame_positions(self.tip, np.ascontiguousarray(zs, float), positions)
        return positions

    def tip_slopes(self, z: ChartPoint) -> np.ndarray:
        """Derivative of the tip's position by the chart at a point of the group's, shape (nv,): shape (3, nv) [m]."""
        slopes = np.empty((3, len(z)))
        frame_slopes(self.tip, np.ascontiguousarray(z, float), slopes)
        return slopes

    @cached_property
    def tip(self) -> CarriedPoint:
        """The group's tip, as kernels know it."""
        tip, origin = _alike_tip(self.group, self.group.tip_id), group_joints(self.group).origin
        return tip._replace(joints=tip.joints._replace(origin=origin))

    def tip_jacobian(self, q: ModelConfiguration) -> np.ndarray:
        """Jacobian of the tip at a configuration of `group.model`, shape (model.nq,).

        Returns:
            Shape (6, nv): linear rows first, at the tip's origin in the world's axes.
        """
        model = self.group.model
        J = pin.computeFrameJacobian(model, self._data, q, self.group.tip_id, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        # Pinocchio gives one joint's Jacobian as a vector
        jacobian: np.ndarray = J.reshape(6, -1) @ self.group.expand_velocity
        return jacobian


@memoized_for_alike
def _alike_tip(group: PlanningGroup, tip_id: int) -> CarriedPoint:
    """A frame of a group, but for where rotation vectors start; of the joints those that lead to it."""
    frame = group.model.frames[tip_id]
    joints, point = alike_group_joints(group), np.array(frame.placement.translation)
    read_only(point)
    chain = chain_of(joints.table, int(frame.parentJoint))
    return CarriedPoint(joints._replace(table=chain), len(chain.parents) - 1, point)
