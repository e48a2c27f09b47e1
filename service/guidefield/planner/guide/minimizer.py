"""What a minimizer does for the guided planner: it reaches points with the tip, and lowers the potential on a plane."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol

import numpy as np

from guidefield.kernels.guide.tip_guard import TipGuard
from guidefield.planner.guide.guided_path import GuidedPath
from guidefield.planner.task.problem import Problem
from guidefield.robot.model.spaces import Configuration


class Minimizer(Protocol):
    """Lowers the potential of the robot while its tip stays on a plane: the thesis' slide and reorient."""

    @property
    def name(self) -> str:
        """Its name, for reports."""

    def reach(self, problem: Problem, q: Configuration, point: np.ndarray) -> Iterable[Configuration]:
        """Configurations near one whose tip is at a point: those that an advance tries, in order.

        Args:
            problem: Robot and limits.
            q: Where the robot is, shape (nq,).
            point: Where its tip shall be, shape (3,) [m, world].
        """

    def settle(self, guided: GuidedPath, point: np.ndarray, normal: np.ndarray, guard: TipGuard) -> None:
        """Slide and reorient on a plane until U falls no more; the guided path takes every step.

        Args:
            guided: The robot, with its tip on the plane.
            point: A point of the plane, shape (3,) [m, world].
            normal: The plane's unit normal, shape (3,), in the world.
            guard: Where the tip may be.
        """
