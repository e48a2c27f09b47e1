"""The seed's three steps towards a guide plane: advance the tip, then slide and reorient to reduce the potential.

planner.md section 3; findings-seed.md sections 2 and 3.
"""

from __future__ import annotations

import enum
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from guidefield.collision.certificate import Verdict, motion_free
from guidefield.planner.constraints import OnPlane, Reorienting, Sliding, TipConstraint
from guidefield.planner.minimizer import descend
from guidefield.planner.problem import Problem
from guidefield.planner.trace import Step
from guidefield.robot.chart import TRANSLATION

MARGIN = 2e-3
"""Distance from obstacles that steps keep if the start does [m]; more than the certificate's floor."""
NEWTON_STEPS = 30
ARRIVED = 1e-6
"""How exactly an advance reaches its point [m]."""
MOST_ROUNDS = 6
"""Rounds of slide and reorient on one plane."""
NEGLIGIBLE = 2e-3
"""Rounds end where U falls by less than this share."""


class Blocks(enum.Enum):
    """How slide and reorient are done: both at once, or in turn (a second try where the first got stuck)."""

    ONE = "one"
    TWO = "two"


@dataclass(frozen=True, eq=False)
class Moved:
    """Where an advance got to.

    Attributes:
        q: Configuration after it; None if no step was feasible.
        step: Distance that the tip moved [m].
        refusal: Why the last trial was refused: the certificate's verdict, or None where the arm couldn't reach.
    """

    q: np.ndarray | None
    step: float
    refusal: Verdict | None


class Walker:
    """Takes steps for one problem and keeps every accepted configuration: they are the path.

    Args:
        problem: What is planned.
        q: Where to start, shape (nq,).
        margin: Distance to keep from obstacles [m].
    """

    def __init__(self, problem: Problem, q: np.ndarray, margin: float, plane: int) -> None:
        self.problem = problem
        self.path = [q]
        self.margin = margin
        self.plane = plane
        self.refusal: Verdict | None = None

    @property
    def q(self) -> np.ndarray:
        """Where the robot is now."""
        return self.path[-1]

    @property
    def tip(self) -> np.ndarray:
        """Where its tip is now, shape (3,) [m]."""
        return self.problem.kinematics.tip_position(self.q)

    def free(self, q0: np.ndarray, q1: np.ndarray) -> bool:
        """Whether the straight joint motion between two configurations is free over its whole length."""
        group = self.problem.group
        z0 = group.chart(q0)
        verdict = motion_free(self.problem.world, z0, group.unwrapped(group.chart(q1), z0), self.margin)
        self.problem.counters.collision_checks += verdict.evaluations
        if not verdict.free:
            self.refusal = verdict
        return verdict.free

    def take(self, q: np.ndarray, kind: str, message: str, potential: float | None = None) -> None:
        """Accept a configuration."""
        self.path.append(q)
        self.problem.tell(Step(kind, q, message, potential, self.plane))

    def advance(self, direction: np.ndarray, step: float, smallest: float) -> Moved:
        """Move the tip along a direction: the largest of step, step/2, step/4 .. that is feasible and free.

        Args:
            direction: Unit vector, shape (3,).
            step: How far at most [m].
            smallest: Below this the advance is given up [m].
        """
        start, tried = self.tip, step
        self.refusal = None
        while tried >= smallest or tried == step:
            q = reach_point(self.problem, self.q, start + tried * direction)
            if q is not None and self.free(self.q, q):
                self.take(q, "advance", f"tip {1000 * tried:.0f} mm towards the plane")
                return Moved(q, tried, None)
            tried *= 0.5
        return Moved(None, 0.0, self.refusal)

    def settle(
        self, point: np.ndarray, normal: np.ndarray, blocks: Blocks, guard: Callable[[np.ndarray], bool]
    ) -> None:
        """Slide and reorient on the plane through `point` until U falls no more.

        Args:
            point: A point of the plane that the tip is on, shape (3,) [m].
            normal: The plane's unit normal, shape (3,).
            blocks: At once, or in turn.
            guard: Whether the tip may be at a point, shape (3,).
        """
        kinematics = self.problem.kinematics

        def accept(q0: np.ndarray, q1: np.ndarray) -> bool:
            return guard(kinematics.tip_position(q1)) and self.free(q0, q1)

        if blocks is Blocks.ONE:
            self._descend(OnPlane(kinematics, point, normal), accept, "descend")
            return
        before = self.problem.robot_field.potential(self.q)
        for _ in range(MOST_ROUNDS):
            rotation = kinematics.frame_placement(self.q, self.problem.group.tip_id).rotation
            self._descend(Sliding(kinematics, point, normal, rotation), accept, "slide")
            after = self._descend(Reorienting(kinematics, self.tip), accept, "reorient")
            if before - after < NEGLIGIBLE * before or self.problem.budget.spent():
                return
            before = after

    def _descend(self, constraint: TipConstraint, accept: Callable[[np.ndarray, np.ndarray], bool], kind: str) -> float:
        descent = descend(self.problem, self.q, constraint, accept)
        for q in descent.path:
            self.take(q, kind, f"{kind} to U = {descent.potential:.4g}", descent.potential)
        return descent.potential


def reach_point(problem: Problem, q: np.ndarray, point: np.ndarray) -> np.ndarray | None:
    """The configuration near q whose tip is at a point, by the least change of joints weighted with their reach.

    Args:
        problem: Robot and limits.
        q: Where the robot is, shape (nq,).
        point: Where its tip shall be, shape (3,) [m].

    Returns:
        A configuration within the limits, shape (nq,), or None if Newton's method does not get there.
    """
    group, kinematics = problem.group, problem.kinematics
    inverse_weights = 1.0 / _reach(problem, q) ** 2
    for _ in range(NEWTON_STEPS):
        missing = point - kinematics.tip_position(q)
        if float(np.linalg.norm(missing)) < ARRIVED:
            return q
        J = kinematics.tip_jacobian(q)[:3]
        z = group.chart(q)
        movable = np.ones(group.nv, bool)
        v = np.zeros(group.nv)
        for _ in range(group.nv):
            W = np.where(movable, inverse_weights, 0.0)
            gram = (J * W) @ J.T
            v = W * (J.T @ np.linalg.solve(gram + 1e-9 * max(float(np.trace(gram)), 1e-12) * np.eye(3), missing))
            stopped = movable & (((z <= group.lower) & (v < 0.0)) | ((z >= group.upper) & (v > 0.0)))
            if not np.any(stopped):
                break
            movable &= ~stopped
        largest = float(np.abs(v).max())
        q = group.clamped(group.integrate(q, v * min(1.0, 0.4 / max(largest, 1e-12))))
    return None


def _reach(problem: Problem, q: np.ndarray) -> np.ndarray:
    """What moving each tangent coordinate by 1 moves, shape (nv,) [m]: its distance to the tip, 1 for a length."""
    group = problem.group
    tip = problem.kinematics.tip_position(q)
    reach = np.ones(group.nv)
    for joint in group.joints:
        origin = problem.kinematics.frame_placement(q, group.model.getFrameId(joint.name)).translation
        at = slice(joint.idx_v, joint.idx_v + joint.nv)
        reach[at] = float(np.linalg.norm(tip - origin)) + 0.05
        if joint.kind in TRANSLATION:
            reach[at][TRANSLATION[joint.kind]] = 1.0
    return reach
