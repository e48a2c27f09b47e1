"""What the tip has to keep while the robot descends: its plane, its orientation, its place."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import pinocchio as pin

from guidefield.robot.kinematics import Kinematics


class TipConstraint(Protocol):
    """Some numbers about the tip that have to stay zero."""

    def error(self, q: np.ndarray) -> np.ndarray:
        """How far from zero they are at a configuration, shape (rows,) [m or rad]."""

    def rows(self, q: np.ndarray) -> np.ndarray:
        """Their derivative by the tangent, shape (rows, nv)."""


@dataclass(frozen=True, eq=False)
class OnPlane:
    """The tip stays on a plane: slide and reorient at once."""

    kinematics: Kinematics
    point: np.ndarray
    normal: np.ndarray

    def error(self, q: np.ndarray) -> np.ndarray:
        """Height above the plane, shape (1,) [m]."""
        return np.array([self.normal @ (self.kinematics.tip_position(q) - self.point)])

    def rows(self, q: np.ndarray) -> np.ndarray:
        """n^T J_p, shape (1, nv)."""
        row: np.ndarray = self.normal @ self.kinematics.tip_jacobian(q)[:3]
        return row[None, :]


@dataclass(frozen=True, eq=False)
class Sliding:
    """The tip stays on a plane and keeps its orientation: the seed's slide."""

    kinematics: Kinematics
    point: np.ndarray
    normal: np.ndarray
    rotation: np.ndarray

    def error(self, q: np.ndarray) -> np.ndarray:
        """Height above the plane [m] and rotation vector from the orientation held [rad], shape (4,)."""
        placement: Any = self.kinematics.frame_placement(q, self.kinematics.group.tip_id)
        turned = pin.log3(placement.rotation @ self.rotation.T)
        height = self.normal @ (placement.translation - self.point)
        return np.array([height, *turned])

    def rows(self, q: np.ndarray) -> np.ndarray:
        """n^T J_p over J_omega, shape (4, nv)."""
        J = self.kinematics.tip_jacobian(q)
        return np.vstack([self.normal @ J[:3], J[3:]])


@dataclass(frozen=True, eq=False)
class Reorienting:
    """The tip stays where it is: the seed's reorient."""

    kinematics: Kinematics
    point: np.ndarray

    def error(self, q: np.ndarray) -> np.ndarray:
        """Displacement of the tip, shape (3,) [m]."""
        error: np.ndarray = self.kinematics.tip_position(q) - self.point
        return error

    def rows(self, q: np.ndarray) -> np.ndarray:
        """J_p, shape (3, nv)."""
        rows: np.ndarray = self.kinematics.tip_jacobian(q)[:3]
        return rows
