"""How near the robot is to a step's goal, by what the goal is about: the tip where it is a pose, else the joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from guidefield.planner.task.problem import Problem, TipGoal
from guidefield.read_only import ReadOnly
from guidefield.robot.model.spaces import ChartPoint, ChartPoints


@dataclass(frozen=True, eq=False)
class PassedGoal(ReadOnly):
    """The goal of a step that is passed.

    Attributes:
        problem: The step's, as it was asked for.
        z: Where it would end, a chart point, shape (nv,).
        radius: How far from there its way may be left [m, rad].
    """

    problem: Problem
    z: ChartPoint
    radius: float

    def distances(self, zs: ChartPoints) -> np.ndarray:
        """How far chart points (k, nv) are from the goal, shape (k,).

        For a pose how far the tip is away [m] or turned [rad], whichever is more; else of the joint that is farthest
        [rad or m].
        """
        if not isinstance(self.problem.goal, TipGoal):
            away: np.ndarray = np.abs(zs - self.z).max(axis=1)
            return away
        here = self._tip(self.z)
        return np.array([_apart(here, self._tip(z)) for z in zs])

    def _tip(self, z: ChartPoint) -> pin.SE3:
        group = self.problem.group
        return self.problem.kinematics.frame_placement(group.expand_from_chart(z), group.tip_id)


def _apart(one: pin.SE3, other: pin.SE3) -> float:
    """How far a placement is from another: away [m] or turned [rad], whichever is more."""
    away = float(np.linalg.norm(other.translation - one.translation))
    return max(away, float(np.linalg.norm(pin.log3(one.rotation.T @ other.rotation))))
