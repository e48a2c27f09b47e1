"""The robot's distance from a step's goal: that of the tip where the goal is a pose, else that of the joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from guidefield.planner.task.problem import Problem, TipGoal
from guidefield.read_only import ReadOnly
from guidefield.robot.model.spaces import ChartPoint, ChartPoints

INSIDE = 0.999
"""Share of a radius within which an optimised motion passes a goal: what is missed in the end is within the rest."""


@dataclass(frozen=True, eq=False)
class PassedGoal(ReadOnly):
    """The goal of a step that is passed.

    Attributes:
        z: Where it would end, a chart point, shape (nv,).
        radius: How far from there its way may be left [m, rad].
    """

    problem: Problem
    z: ChartPoint
    radius: float

    @property
    def tip_plane(self) -> None:
        """It is no plane that the tip crosses, see `Place`."""
        return None

    @property
    def is_of_tip(self) -> bool:
        """True if it is about the tip."""
        return isinstance(self.problem.goal, TipGoal)

    @property
    def placement(self) -> pin.SE3:
        """Where the tip would be, a pinocchio.SE3 [m, world]."""
        return self._tip(self.z)

    def distances(self, zs: ChartPoints) -> np.ndarray:
        """How far chart points (k, nv) are from the goal, shape (k,).

        For a pose how far the tip is away [m] or turned [rad], whichever is more; else of the joint that is farthest
        [rad or m].
        """
        if not self.is_of_tip:
            away: np.ndarray = np.abs(zs - self.z).max(axis=1)
            return away
        here = self.placement
        return np.array([_apart(here, self._tip(z)) for z in zs])

    def missed(self, zs: ChartPoints) -> np.ndarray:
        """How far chart points (k, nv) are beyond the radius, as a place that a motion passes.

        Of a pose how far the tip is away and turned, shape (k, 2); else each coordinate, shape (k, nv).
        """
        if not self.is_of_tip:
            apart = np.abs(zs - self.z)
        else:
            here = self.placement
            apart = np.array([_differences(here, self._tip(z)) for z in zs])
        return np.maximum(apart - INSIDE * self.radius, 0.0)

    def rows(self, z: ChartPoint) -> np.ndarray:
        """The derivative of `missed` by the chart at a point (nv,), shape (2, nv) or (nv, nv)."""
        missed = self.missed(z[None])[0]
        if not self.is_of_tip:
            return np.diag(np.where(missed > 0.0, np.sign(z - self.z), 0.0))
        group, here, there = self.problem.group, self.placement, self._tip(z)
        J = self.problem.kinematics.tip_jacobian(group.expand_from_chart(z)) @ group.tangent_map(z)
        away, turned = there.translation - here.translation, pin.log3(there.rotation @ here.rotation.T)
        sizes = np.maximum([np.linalg.norm(away), np.linalg.norm(turned)], 1e-300)
        return np.where(missed[:, None] > 0.0, np.array([away @ J[:3], turned @ J[3:]]) / sizes[:, None], 0.0)

    def _tip(self, z: ChartPoint) -> pin.SE3:
        group = self.problem.group
        return self.problem.kinematics.frame_placement(group.expand_from_chart(z), group.tip_id)


def _apart(one: pin.SE3, other: pin.SE3) -> float:
    """How far a placement is from another: away [m] or turned [rad], whichever is more."""
    return max(_differences(one, other))


def _differences(one: pin.SE3, other: pin.SE3) -> tuple[float, float]:
    """How far a placement is away from another [m], and how far it is turned [rad]."""
    away = float(np.linalg.norm(other.translation - one.translation))
    return away, float(np.linalg.norm(pin.log3(one.rotation.T @ other.rotation)))
