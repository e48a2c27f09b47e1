"""The target pose of a tip, with tolerances."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from guidefield.geometry.placements import se3
from guidefield.messages.requests import PoseGoal, TargetPose
from guidefield.read_only import read_only

EXACT = 1e-6
"""A tolerance of zero, or any smaller than this, means this [m, rad]."""


@dataclass(frozen=True, eq=False)
class PoseTarget:
    """A pose for the tip, and how far from it the tip may be, along and about the axes of the target's own frame.

    Attributes:
        placement: ``T_world_target``, pinocchio.SE3.
        position_tolerance: Shape (3,) [m]; infinite where an axis is free.
        orientation_tolerance: Shape (3,), about each axis, as components of the rotation vector from target to tip
            [rad]; infinite where an axis is free.
    """

    placement: Any
    position_tolerance: np.ndarray
    orientation_tolerance: np.ndarray

    @classmethod
    def from_wire(cls, pose: TargetPose | PoseGoal) -> PoseTarget:
        """The target that a message means; null is a free axis."""
        tolerances = [
            np.array([np.inf if axis is None else axis for axis in axes])
            for axes in (pose.position_tolerance, pose.orientation_tolerance)
        ]
        read_only(*tolerances)
        return cls(se3(pose.position, pose.quaternion_xyzw), *tolerances)

    def is_reached(self, T_world_tip: Any) -> bool:
        """Whether a placement of the tip (pinocchio.SE3) is within the tolerances."""
        offset = self.placement.actInv(T_world_tip)
        return bool(
            np.all(np.abs(offset.translation) <= np.maximum(self.position_tolerance, EXACT))
            and np.all(np.abs(pin.log3(offset.rotation)) <= np.maximum(self.orientation_tolerance, EXACT))
        )
