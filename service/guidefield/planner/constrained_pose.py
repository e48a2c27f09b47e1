"""Move configurations that reach a pose to nearby ones that reach it and keep the path constraints.

A goal pose has tolerances, and a search for it ends anywhere within them, mostly at their edge. Gauss and Newton's
steps of least length on all that is exceeded, tolerances and constraints together, lead to where both hold.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from guidefield.planner.connect.settings import CONSTRAINED
from guidefield.planner.task.problem import Problem
from guidefield.robot.ik.pose_target import EXACT, PoseTarget
from guidefield.robot.ik.settings import SEARCH
from guidefield.robot.model.spaces import ChartPoint, ChartPoints

STEPS = 15
"""Steps at most. From the edges of tolerances three to six lead to where both hold."""

TRIES = 20
"""After so many configurations in a row that can't be helped no other is tried: the constraint is out of reach."""

DAMPING = 1e-9
"""Of the steps, relative to the largest singular value: a row that nothing moves is given up."""


class PoseKeeper:
    """Moves configurations that reach a pose and violate a path constraint to nearby ones that keep both."""

    def __init__(self, problem: Problem, target: PoseTarget) -> None:
        self._problem, self._target = problem, target
        self._tries = TRIES

    def __call__(self, zs: ChartPoints) -> ChartPoints:
        """Chart points (n, nv) that reach the pose, some moved; those that aren't helped stay as they are."""
        if not self._problem.path_constraints:
            return zs
        moved: ChartPoints = zs.copy()
        for row, z in enumerate(zs):
            if self._tries == 0:
                break
            found = _move_within(self._problem, self._target, z)
            self._tries = self._tries - 1 if found is None else TRIES
            moved[row] = z if found is None else found
        return moved


def _move_within(problem: Problem, target: PoseTarget, z: ChartPoint) -> ChartPoint | None:
    """A chart point (nv,) that reaches the pose and keeps the constraints, next to another; None if none is found."""
    frames, group = problem.constrained_frames, problem.group
    there = z.copy()
    for _ in range(STEPS):
        values, slopes = frames.values_and_rows(there)
        excess, rows, reached = _pose_excess(problem, target, there)
        if reached and (values <= frames.limits).all():
            return there
        beyond = values - CONSTRAINED.room * frames.limits
        excess = np.concatenate([excess, np.maximum(beyond, 0.0)])
        active = excess != 0.0
        step = np.linalg.pinv(np.concatenate([rows, slopes])[active], rcond=DAMPING) @ excess[active]
        there = np.clip(there - step, group.lower, group.upper)
    return None


def _pose_excess(problem: Problem, target: PoseTarget, z: ChartPoint) -> tuple[np.ndarray, np.ndarray, bool]:
    """The tip's excess over the aimed part of the tolerances, shape (6,), its derivative (6, nv), and if it is there.

    All along and about the axes of the target's frame, translation first [m, rad].
    """
    group, kinematics = problem.group, problem.kinematics
    q = group.expand_from_chart(z)
    tip = kinematics.frame_placement(q, group.tip_id)
    offset = target.placement.actInv(tip)
    away = np.concatenate([offset.translation, pin.log3(offset.rotation)])
    allowed = np.concatenate([target.position_tolerance, target.orientation_tolerance])
    aimed = np.where(allowed > EXACT, SEARCH.aim * allowed, 0.0)
    jacobian = kinematics.tip_jacobian(q) @ group.tangent_map(z)
    linear = target.placement.rotation.T @ jacobian[:3]
    angular = pin.Jlog3(offset.rotation) @ tip.rotation.T @ jacobian[3:]
    excess = np.sign(away) * np.maximum(np.abs(away) - aimed, 0.0)
    return excess, np.concatenate([linear, angular]), target.is_reached(tip)
