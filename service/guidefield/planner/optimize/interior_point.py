"""Newton's method on a motion's control points and the length of its pieces, at one weight of the limits' barrier."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from guidefield.kernels.distance.distance import DistanceTables
from guidefield.kernels.linalg.bordered_band import COUPLED, solve_bordered
from guidefield.kernels.optimize.limit_barrier import MotionLimits, limit_barrier
from guidefield.kernels.optimize.motion_objective import MotionSamples, motion_objective
from guidefield.kernels.relax.sampled_robot import SampledRobot
from guidefield.kernels.relax.verlet_list import NearBodies, nothing_remembered
from guidefield.planner.optimize.bspline import ENDS, BSpline
from guidefield.planner.optimize.clearance_samples import clearance_samples
from guidefield.planner.optimize.settings import OptimizationSettings
from guidefield.read_only import ReadOnly


@dataclass(frozen=True, eq=False)
class Question(ReadOnly):
    """What is the same all through an optimisation.

    Attributes:
        robot: Points and links.
        tables: Obstacles.
        limits: What is kept.
        kept: What start and end keep from obstacles [m].
        clearance: What is asked for [m].
        duration: Of the first motion [s]: the unit of time.
        settings: Weights and bounds.
        longest_step: Pieces are no longer than this [s].
    """

    robot: SampledRobot
    tables: DistanceTables
    limits: MotionLimits
    kept: tuple[float, float]
    clearance: float
    duration: float
    settings: OptimizationSettings
    longest_step: float = math.inf


@dataclass(frozen=True, eq=False)
class State(ReadOnly):
    """A motion, and its objective with derivatives by the inner control points and the step's logarithm.

    Attributes:
        spline: The motion.
        value: The objective.
        gradient: Shape (k + 1,), k = (m - 3) nv, m pieces.
        blocks, border: Hessian, as `motion_objective` gives it.
    """

    spline: BSpline
    value: float
    gradient: np.ndarray
    blocks: np.ndarray
    border: np.ndarray


@dataclass(frozen=True, eq=False)
class Descent(ReadOnly):
    """The objective at one weight of the limits' barrier, on the samples of the motion with which it began.

    Attributes:
        question: What is asked.
        samples: Where the clearance is looked at.
        near: Which obstacles were near there; kept up to date by looking at them.
        limit_weight: The weight of the limits' barrier.
    """

    question: Question
    samples: MotionSamples
    near: NearBodies
    limit_weight: float

    @classmethod
    def of(cls, question: Question, spline: BSpline, limit_weight: float) -> Descent:
        """For a motion."""
        settings = question.settings
        samples = clearance_samples(spline, question.kept, question.clearance, settings.weight, settings)
        near = nothing_remembered(len(samples.pieces), len(question.robot.groups))
        return cls(question, samples, near, limit_weight)

    def at(self, spline: BSpline) -> State:
        """The objective of a motion strictly within limits."""
        question, (n, nv) = self.question, spline.points.shape
        inner = n - 2 * ENDS
        blocks = np.empty((inner, nv, (COUPLED + 1) * nv))
        border, gradient = np.empty(inner * nv + 1), np.empty(inner * nv + 1)
        value = motion_objective(
            question.robot,
            question.tables,
            self.samples,
            question.limits,
            spline.points,
            spline.slopes,
            spline.step,
            question.duration / spline.pieces,
            self.limit_weight,
            question.clearance,
            self.near,
            blocks,
            border,
            gradient,
        )
        self._hold_fixed(blocks, border, gradient)
        return State(spline, value, gradient, blocks, border)

    def _hold_fixed(self, blocks: np.ndarray, border: np.ndarray, gradient: np.ndarray) -> None:
        """Cut coordinates whose range is a single value out of the system."""
        limits = self.question.limits
        fixed = np.flatnonzero(limits.lower >= limits.upper)
        if not len(fixed):
            return
        inner, nv, _ = blocks.shape
        blocks[:, fixed] = 0.0
        blocks.reshape(inner, nv, COUPLED + 1, nv)[..., fixed] = 0.0
        blocks[:, fixed, COUPLED * nv + fixed] = 1.0
        for row in (border, gradient):
            row[:-1].reshape(inner, nv)[:, fixed] = 0.0

    def stepped(self, state: State) -> State | None:
        """The motion after a step that lowers the objective; None where there is none worth taking."""
        settings, step = self.question.settings, np.empty_like(state.gradient)
        right = -state.gradient
        if not solve_bordered(
            state.blocks, state.border[:-1], state.border[-1], right[:-1], right[-1], settings.damping, step
        ):
            return None
        if right @ step < settings.settled * abs(state.value):
            return None
        spline, stride = state.spline, min(1.0, settings.longest / float(np.abs(step).max()))
        move, stretch = step[:-1].reshape(spline.inner.shape), float(step[-1])
        most = math.log(self.question.longest_step / spline.step)
        for _ in range(settings.tries):
            trial = spline.moved(stride * move, min(stride * stretch, most))
            if math.isfinite(limit_barrier(trial.points, trial.step, self.question.limits)):
                moved = self.at(trial)
                if moved.value < state.value:
                    return moved
            stride *= settings.shorter
        return None
