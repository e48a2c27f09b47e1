"""Projected: descend the potential on the manifold of configurations whose tip keeps a constraint.

planner.md section 3, "Projected"; findings-seed.md section 3. A step is ``v = -(y - Z C y)`` with ``y = M^-1 g`` and
``Z = M^-1 C^T (C M^-1 C^T)^-1``: Newton's step in the metric M of nearby faces' curvature, less the part that would
leave the constraint. It is taken back onto the constraint by up to three corrections with the same Z.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from guidefield.kernels.cholesky import solve_definite
from guidefield.planner.constraints import TipConstraint
from guidefield.planner.problem import Problem
from guidefield.robot.chart import TRANSLATION

REGULARIZATION = 1e-2
"""Share of the metric's mean diagonal added to it: full steps are mostly accepted, symmetric links don't spin."""
LARGEST_TURN = np.deg2rad(15.0)
"""No joint turns more than this in one step [rad]."""
LARGEST_SLIDE = 0.1
"""No prismatic joint moves more than this in one step [m]."""
CORRECTIONS = 3
ON_CONSTRAINT = 1e-5
"""How near a trial has to come to the constraint [m or rad]."""
TRIALS = 10
SUFFICIENT_DECREASE = 1e-4
TOLERANCE = 1e-3
"""A descent ends where a step promises, or brings, less than this share of U."""
MOST_STEPS = 60

Accept = Callable[[np.ndarray, np.ndarray], bool]


@dataclass(frozen=True, eq=False)
class Descent:
    """Where a descent ended: the configurations accepted on the way (without the first), and U at the end [m]."""

    path: tuple[np.ndarray, ...]
    potential: float


def descend(
    problem: Problem,
    q: np.ndarray,
    constraint: TipConstraint,
    accept: Accept,
    tolerance: float = TOLERANCE,
    most_steps: int = MOST_STEPS,
) -> Descent:
    """Reduce U while the tip keeps a constraint.

    Args:
        problem: Robot, field, limits and budget.
        q: Configuration on the constraint, shape (nq,).
        constraint: What the tip has to keep.
        accept: Whether the motion from one configuration to another may be taken (guard, collision).
        tolerance: It ends where a step promises, or brings, less than this share of U.
        most_steps: It ends after so many steps.
    """
    here = problem.robot_field.evaluate(q)
    path: list[np.ndarray] = []
    for _ in range(most_steps):
        if problem.budget.spent():
            break
        step = _direction(problem, q, here.gradient, here.metric, constraint)
        if step is None or -step.slope < tolerance * here.potential:
            break
        trial = _line_search(problem, q, here.potential, step, constraint, accept)
        if trial is None:
            break
        path.append(trial)
        q, before, here = trial, here.potential, problem.robot_field.evaluate(trial)
        problem.counters.iterations += 1
        if before - here.potential < tolerance * before:
            break
    return Descent(tuple(path), here.potential)


@dataclass(frozen=True, eq=False)
class _Step:
    """A tangent that reduces U, its slope g.v, and the corrections' matrix Z (nv, rows)."""

    v: np.ndarray
    slope: float
    Z: np.ndarray


def _direction(
    problem: Problem, q: np.ndarray, gradient: np.ndarray, metric: np.ndarray, constraint: TipConstraint
) -> _Step | None:
    """The projected step over the joints that are free to move; None where there is no freedom, or no finite metric."""
    group = problem.group
    z = group.chart(q) if group.limited else q  # unlimited joints are never blocked
    blocked = np.zeros(group.nv, bool)
    for _ in range(group.nv):
        free = np.flatnonzero(~blocked)
        if not len(free):
            return None
        M = metric[np.ix_(free, free)]
        M = M + max(REGULARIZATION * np.trace(M) / len(free), 1e-12) * np.eye(len(free))
        C = constraint.rows(q)[:, free]
        solved = np.empty((len(free), 1 + len(C)))
        if not solve_definite(M, np.c_[gradient[free], C.T], solved):
            return None
        y, MC = solved[:, 0], solved[:, 1:]
        gram = C @ MC
        Z_free = MC @ _inverse(gram)
        v_free = -(y - Z_free @ (C @ y))
        v, Z = np.zeros(group.nv), np.zeros((group.nv, C.shape[0]))
        v[free], Z[free] = v_free, Z_free
        if not group.limited:
            break
        # a joint at its limit that the step would push beyond leaves g, M and C
        pushed = ((z <= group.lower + 1e-9) & (v < 0.0)) | ((z >= group.upper - 1e-9) & (v > 0.0))
        if not np.any(pushed & ~blocked):
            break
        blocked |= pushed
    slope = float(gradient @ v)
    if slope >= 0.0:
        return None
    largest = np.full(group.nv, LARGEST_TURN)
    for joint in group.joints:
        if joint.kind in TRANSLATION:
            largest[joint.idx_v : joint.idx_v + joint.nv][TRANSLATION[joint.kind]] = LARGEST_SLIDE
    scale = min(1.0, 1.0 / max(float(np.max(np.abs(v) / largest)), 1e-30))
    return _Step(scale * v, scale * slope, Z)


def _inverse(gram: np.ndarray) -> np.ndarray:
    """Inverse of a small symmetric matrix; of what is singular, where two rows ask for the same, the pseudo-inverse."""
    if gram.shape == (1, 1):
        return np.array([[1.0 / gram[0, 0] if gram[0, 0] > 0.0 else 0.0]])
    inverse: np.ndarray = np.linalg.pinv(gram, rcond=1e-9)
    return inverse


def _line_search(
    problem: Problem, q: np.ndarray, potential: float, step: _Step, constraint: TipConstraint, accept: Accept
) -> np.ndarray | None:
    alpha = 1.0
    for _ in range(TRIALS):
        trial = _retracted(problem, q, alpha * step.v, step.Z, constraint)
        if trial is not None:
            bound = potential + SUFFICIENT_DECREASE * alpha * step.slope
            if problem.robot_field.potential(trial) <= bound and accept(q, trial):
                return trial
        alpha *= 0.5
    return None


def _retracted(
    problem: Problem, q: np.ndarray, v: np.ndarray, Z: np.ndarray, constraint: TipConstraint
) -> np.ndarray | None:
    """The configuration along v, brought back onto the constraint and into the limits; None if that fails."""
    group = problem.group
    trial = group.clamped(group.integrate(q, v))
    for _ in range(CORRECTIONS):
        error = constraint.error(trial)
        if float(np.abs(error).max()) <= 0.1 * ON_CONSTRAINT:
            return trial
        trial = group.clamped(group.integrate(trial, -Z @ error))
    return trial if float(np.abs(constraint.error(trial)).max()) <= ON_CONSTRAINT else None
