"""Projected: the minimizer for any chain of joints; it descends on the manifold of configurations on a plane."""

from __future__ import annotations

import enum
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from guidefield.planner.constraints import OnPlane, Reorienting, Sliding, TipConstraint
from guidefield.planner.minimizer import MOST_STEPS, TOLERANCE, descend
from guidefield.planner.problem import Problem
from guidefield.planner.settling import MOST_ROUNDS, NEGLIGIBLE, Guard
from guidefield.planner.steps import Walker, reach_point


class Blocks(enum.Enum):
    """How slide and reorient are done: both at once, or in turn (a second try where the first got stuck)."""

    ONE = "one block"
    TWO = "two blocks"


@dataclass(frozen=True)
class Projected:
    """Newton's steps in the metric of nearby faces' curvature, projected on the tip's constraint (minimizer.py).

    Attributes:
        blocks: At once, or in turn.
        tolerance: A descent ends where a step promises, or brings, less than this share of U.
        most_steps: Steps of one descent.
    """

    blocks: Blocks = Blocks.ONE
    tolerance: float = TOLERANCE
    most_steps: int = MOST_STEPS

    @property
    def name(self) -> str:
        """Its name, for reports."""
        return f"projected in {self.blocks.value}"

    def reach(self, problem: Problem, q: np.ndarray, point: np.ndarray) -> Iterator[np.ndarray]:
        """The one configuration that changes the joints least."""
        reached = reach_point(problem, q, point)
        if reached is not None:
            yield reached

    def settle(self, walker: Walker, point: np.ndarray, normal: np.ndarray, guard: Guard) -> None:
        """Slide and reorient on a plane until U falls no more."""
        problem = walker.problem
        kinematics = problem.kinematics

        def accept(q0: np.ndarray, q1: np.ndarray) -> bool:
            return guard(kinematics.tip_position(q1)) and walker.free(q0, q1)

        if self.blocks is Blocks.ONE:
            self._descend(walker, OnPlane(kinematics, point, normal), accept, "descend")
            return
        before = problem.robot_field.potential(walker.q)
        for _ in range(MOST_ROUNDS):
            rotation = kinematics.frame_placement(walker.q, problem.group.tip_id).rotation
            self._descend(walker, Sliding(kinematics, point, normal, rotation), accept, "slide")
            after = self._descend(walker, Reorienting(kinematics, walker.tip), accept, "reorient")
            if before - after < NEGLIGIBLE * before or problem.budget.spent():
                return
            before = after

    def _descend(
        self, walker: Walker, constraint: TipConstraint, accept: Callable[[np.ndarray, np.ndarray], bool], kind: str
    ) -> float:
        descent = descend(walker.problem, walker.q, constraint, accept, self.tolerance, self.most_steps)
        for q in descent.path:
            walker.take(q, kind, f"{kind} to U = {descent.potential:.4g}", descent.potential)
        return descent.potential
