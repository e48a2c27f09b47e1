"""Newton's method on a motion's control points and the length of its pieces, between evaluations of its clearance.

An evaluation computes clearance and loads (torques, speeds in space) with their derivatives, which takes far more time
than all else. So Newton's method goes on with its quadratic model as long as that brings much, before the next
evaluation. The constants change the motion and the number of evaluations; limits of rates are kept whatever they are.
Loads are measured again in the end: a motion beyond them that can't be slowed down is refused.
service/docs/algorithm.md and motions.md repeat `FREE_SHARE`.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, cast

import numpy as np

from guidefield.kernels.distance.distance import DistanceTables
from guidefield.kernels.optimize.barrier import MovingBodies, SampledRobot
from guidefield.kernels.optimize.clearance_model import ClearanceModel, MotionSamples, clearance_along
from guidefield.kernels.optimize.limit_barrier import MotionLimits, TimeLimits, limit_barrier, time_barrier
from guidefield.kernels.optimize.load_expansions import (
    expand_speed_loads,
    expand_torque_loads,
    largest_speed_loads,
    largest_torque_loads,
)
from guidefield.kernels.optimize.motion_objective import MotionEnds
from guidefield.kernels.optimize.newton_descent import (
    DescentBuffers,
    DescentRules,
    allocate_descent_buffers,
    newton_descent,
)
from guidefield.kernels.optimize.obstacle_barrier import NearBodies, nothing_remembered
from guidefield.kernels.optimize.penalties import KeptSamples, LoadModel, constraint_penalty, load_penalty
from guidefield.memo import memoized_by_value
from guidefield.planner.motion.bspline import BSpline, basis, basis_bends, basis_slopes
from guidefield.planner.optimize.clearance_samples import Sections, clearance_samples, constraint_samples
from guidefield.planner.optimize.passages import Passage, add_passage, nearest
from guidefield.planner.optimize.settings import OptimizationSettings
from guidefield.planner.task.effort import EffortLimit
from guidefield.planner.task.motion_limits import CartesianLimit, MotionLimit
from guidefield.read_only import ReadOnly, read_only

# By 30 public problems of a Panda with 3 kg in the hand, at 15 rad/s² and 500 rad/s³.
TORQUE_SAMPLES = 128  # about this many on a motion, two on each piece at least. With 64 motions are 2 % slower
# the same where no torques are limited, one on each piece at least. With 128 motions take as long
SPEED_SAMPLES = 64
# share of its limit up to which a load costs nothing. With 0.9 and 0.97 motions are 0.5 and 1 % slower
FREE_SHARE = 0.95
# share from which on a load is linearized. With 0.4 there are 4 % fewer evaluations, with 0.75 and 0.9 11 and 36 %
# more; as long as only what is beyond `FREE_SHARE` was linearized there were three times as many
LINEARIZE_ABOVE = 0.6


class _LoadMemory(NamedTuple):
    """Memory for the loads of an evaluation: the largest, and the linearized ones as `LoadModel` has them."""

    largest: np.ndarray  # at each sample, by limit, shape (l, pieces s)
    pieces: np.ndarray
    samples: np.ndarray
    values: np.ndarray
    slopes: np.ndarray


@memoized_by_value(16)
def no_loads(nv: int) -> LoadModel:
    """No loads of a motion of a given number of coordinates."""
    none = np.empty((0, 3, 4)), np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0), np.empty((0, 3, nv))
    read_only(*none)
    return LoadModel(0, 0, 0.0, FREE_SHARE, *none)


@dataclass(frozen=True, eq=False)
class LoadSamples(ReadOnly):
    """The samples at which a motion's loads are examined, with memory for two evaluations, by turns."""

    effort: EffortLimit | None
    speeds: tuple[CartesianLimit, ...]
    bases: np.ndarray  # on a piece of length 1, shape (s, 3, 4)
    memory: tuple[_LoadMemory, _LoadMemory]
    seen: tuple[_LoadMemory, _LoadMemory]  # the same, read-only

    @classmethod
    def of(cls, limits: Sequence[MotionLimit], pieces: int, nv: int) -> LoadSamples:
        """Make samples for a motion of a given number of pieces and coordinates."""
        effort = next((one for one in limits if isinstance(one, EffortLimit)), None)
        speeds = tuple(one.sketched for one in limits if isinstance(one, CartesianLimit))
        # accelerations are largest at the ends of pieces: one sample in the middle would miss torques there
        count = max(2, round(TORQUE_SAMPLES / pieces)) if effort else max(1, round(SPEED_SAMPLES / pieces))
        at = (np.arange(count) + 0.5) / count
        bases = np.ascontiguousarray(np.stack([basis(at), basis_slopes(at), basis_bends(at)], axis=1))
        largest = np.empty(((effort is not None) + len(speeds), pieces * count))
        most = pieces * count * ((len(effort.limited) if effort else 0) + 3 * len(speeds))
        memory = [
            _LoadMemory(
                largest, np.empty(most, np.int64), np.empty(most, np.int64), np.empty(most), np.empty((most, 3, nv))
            )
            for _ in range(2)
        ]
        seen = [_LoadMemory(*(array.view() for array in one)) for one in memory]
        read_only(bases, *seen[0], *seen[1])
        return cls(effort, speeds, bases, (memory[0], memory[1]), (seen[0], seen[1]))

    def mean(self, spline: BSpline) -> float:
        """The mean load of a motion, by the limit by which it is largest."""
        self.measure(spline)
        return float(self.memory[0].largest.mean(axis=1).max(initial=0.0))

    def weight(self, weight: float) -> float:
        """Weight of each sample's half square, so that their sum is `weight` times their mean."""
        return weight / float(self.memory[0].largest.shape[1])

    def measure(self, spline: BSpline) -> float:
        """Evaluate the loads of a motion; return the sum of squares beyond `FREE_SHARE`."""
        total, rows = 0.0, iter(self.memory[0].largest)
        where = spline.points, spline.step, self.bases, FREE_SHARE
        if self.effort is not None:
            total += largest_torque_loads(self.effort.tree, self.effort.limits, *where, next(rows))
        for one in self.speeds:
            total += largest_speed_loads(one.body, one.speed, *where, next(rows))
        return total

    def linearize(self, spline: BSpline, turn: int, weight: float) -> LoadModel:
        """Linearize the loads that were measured last, into one of the two memories, with a weight of their mean."""
        count, (largest, *memory) = 0, self.memory[turn]
        rows = iter(largest)
        where = spline.points, spline.step, self.bases
        if self.effort is not None:
            tree, most = self.effort.tree, self.effort.limits
            count = expand_torque_loads(tree, most, *where, next(rows), LINEARIZE_ABOVE, *memory)
        torques = count
        for one in self.speeds:
            count = expand_speed_loads(one.body, one.speed, *where, next(rows), LINEARIZE_ABOVE, count, *memory)
        return LoadModel(torques, count, self.weight(weight), FREE_SHARE, self.bases, *self.seen[turn][1:])


SOFTER = 0.7  # factor of the stiffness if the motion that the model gave proved better. Unrecorded
STIFFER = 2.0  # the same where it was not, to 1 at most. Unrecorded
# Newton's method takes no further step once a coordinate is farther than this from the last evaluation [rad or m]; a
# single step may pass it. With 0.1 and 0.5 the same motions in the same time, on the problems of `settings`
STOP_DISTANCE = 0.25
CLOSER = 0.4  # a motion that proves no better is tried at this share of the way to there. Unrecorded
MAX_CLOSER = 8  # so often at most. Unrecorded
TRIES = 24  # how often a step is tried shorter, or a motion closer to be within limits, at most. Unrecorded
MOST_STRETCHED = 0.5  # most that the logarithm of the length of pieces changes in one step. Unrecorded
DAMPING = 1e-9  # added to the Hessian's diagonal, as a share of it, against rounding

# weight of half the square of what is missed of a passage, against the arrival time, which counts from 1 [1/m² at
# size 1, or 1/rad²]
PASSAGE_WEIGHT = 1e5


@functools.cache
def _machine_code(kernel: Any) -> Any:
    """The entry of a kernel that was called before, which doesn't examine the types of arguments."""
    return next(iter(kernel.overloads.values())).entry_point if len(kernel.overloads) == 1 else kernel


class _CheckedOnce:
    """A kernel whose arguments are of the same types in each call: numba examines them in the first call alone.

    It examines the seventy arrays of an evaluation's arguments for 17 us, of the 60 that an easy evaluation takes.
    """

    def __init__(self, kernel: Any) -> None:
        self._kernel, self._call = kernel, kernel

    def __call__(self, *arguments: Any) -> Any:
        found = self._call(*arguments)
        if self._call is self._kernel:
            self._call = _machine_code(self._kernel)
        return found


@dataclass(frozen=True, eq=False)
class OptimizationProblem(ReadOnly):
    """All that stays the same during an optimisation."""

    robot: SampledRobot
    tables: DistanceTables
    moving: MovingBodies
    sections: Sections
    limits: MotionLimits
    kept: tuple[float, float]  # distances of start and end from obstacles [m]
    clearance: float  # the requested one [m]
    duration: float  # of the first motion [s]: the unit of time
    settings: OptimizationSettings
    times: TimeLimits
    longest_step: float = math.inf  # pieces are no longer than this [s]
    passages: tuple[Passage, ...] = ()
    motion_limits: tuple[MotionLimit, ...] = ()  # limits of what it does as a whole

    @cached_property
    def clearance_along(self) -> _CheckedOnce:
        """The kernel that evaluates clearances."""
        return _CheckedOnce(clearance_along)

    @cached_property
    def newton_descent(self) -> _CheckedOnce:
        """The kernel of Newton's method."""
        return _CheckedOnce(newton_descent)

    @cached_property
    def limit_barrier(self) -> _CheckedOnce:
        """The kernel of the barrier of limits."""
        return _CheckedOnce(limit_barrier)

    @cached_property
    def rules(self) -> DescentRules:
        """The rules by which Newton's steps are taken."""
        settings = self.settings
        return DescentRules(
            steps=settings.newton_steps,
            tries=TRIES,
            shorter=settings.shorter,
            settled=settings.settled,
            little=settings.little,
            longest=settings.longest,
            most_stretched=MOST_STRETCHED,
            trusted=STOP_DISTANCE,
            damping=DAMPING,
        )


class Evaluation(NamedTuple):
    """A motion and its clearance."""

    spline: BSpline
    model: ClearanceModel  # its clearance there, and nearby, with what it misses of its passages
    loads: LoadModel
    constrained: KeptSamples
    passed: tuple[float, ...]  # where it comes nearest to each passage, in pieces from the start
    stiffness: float  # share of Gauss and Newton's Hessian of the clearance that the model has


class _Derivatives(NamedTuple):
    gradient: np.ndarray
    pieces: np.ndarray
    basis: np.ndarray
    hessians: np.ndarray
    border: np.ndarray
    by_times: np.ndarray
    corner: np.ndarray


class _Memory(NamedTuple):
    written: _Derivatives
    seen: _Derivatives

    @classmethod
    def of(cls, places: int, n: int, nv: int) -> _Memory:
        written = _Derivatives(
            np.empty((n, nv)),
            np.empty(places, np.int64),
            np.empty((places, 4)),
            np.empty((places, nv, nv)),
            np.empty((2, n, nv)),
            np.empty(2),
            np.empty((2, 2)),
        )
        seen = _Derivatives(*(array.view() for array in written))
        read_only(*seen)
        return cls(written, seen)


@dataclass(frozen=True, eq=False)
class PenalizedObjective(ReadOnly):
    """The objective on the samples of the motion with which it began."""

    question: OptimizationProblem
    samples: MotionSamples
    near: NearBodies  # which obstacles were near there; kept up to date by evaluations
    count: int
    loads: LoadSamples | None  # None where nothing limits any
    constrained: KeptSamples
    ends: MotionEnds
    unit: float  # length of the first motion's pieces, if it had as many [s]
    buffers: DescentBuffers
    nothing_loaded: LoadModel
    # memory for the derivatives of two evaluations, by turns: new one would cost as much as a third of an evaluation
    memory: tuple[_Memory, _Memory]

    @classmethod
    def of(cls, question: OptimizationProblem, spline: BSpline, samples: int) -> PenalizedObjective:
        """For a motion, with a given number of samples on a piece."""
        in_time = len(question.moving.motions) > 0
        placed = clearance_samples(
            spline,
            question.kept,
            question.clearance,
            samples,
            question.settings,
            question.limits.sizes,
            in_time=in_time,
        )
        near = nothing_remembered(len(placed.pieces), len(question.robot.groups))
        both = spline.start, spline.end
        ends = MotionEnds(
            np.array([one.position for one in both]),
            np.array([one.velocity for one in both]),
            np.array([one.acceleration for one in both]),
        )
        read_only(*ends)
        constrained = constraint_samples(question.sections, spline.pieces, (), samples)
        n, nv = spline.points.shape
        buffers, unit = allocate_descent_buffers(n, nv, question.times), question.duration / spline.pieces
        places = len(placed.pieces) + len(question.passages)
        memory = _Memory.of(places, n, nv), _Memory.of(places, n, nv)
        loads = LoadSamples.of(question.motion_limits, spline.pieces, nv) if question.motion_limits else None
        return cls(question, placed, near, samples, loads, constrained, ends, unit, buffers, no_loads(nv), memory)

    def evaluate(
        self,
        spline: BSpline,
        passed: tuple[float, ...] = (),
        stiffness: float = 1.0,
        most: float = math.inf,
        beside: Evaluation | None = None,
    ) -> Evaluation:
        """Evaluate the clearance of a motion, which costs most, and its passages, near where they were.

        Its derivatives are good until the next evaluation, or where that is `beside` it, until the one after that.

        Args:
            passed: Where it came nearest to each passage, in pieces from the start.
            stiffness: As `Evaluation.stiffness`.
            most: Clearance from which on the motion isn't wanted: it counts as infinite then.
        """
        question, loads = self.question, self.loads
        one, other = self.memory
        turn = 1 if beside is not None and beside.model.hessians is one.seen.hessians else 0
        written, seen = other if turn else one
        weight = question.settings.load_weight
        if loads is not None:
            most -= 0.5 * loads.weight(weight) * loads.measure(spline)
        value, count = question.clearance_along(
            question.robot,
            question.tables,
            question.moving,
            self.samples,
            spline.points,
            spline.step,
            spline.begin,
            question.clearance,
            most,
            self.near,
            *written,
        )
        gradient, pieces, basis, hessians, border, _, corner = written
        if stiffness != 1.0:
            hessians[:count] *= stiffness
            border *= stiffness
            corner *= stiffness
        here = []
        crossing = question.settings.crossing * self.count / question.settings.samples  # of pieces that are shorter
        for passage, about in zip(question.passages, passed, strict=True):
            here.append(nearest(passage.place, spline, about))
            value += add_passage(
                passage.place, spline, here[-1], PASSAGE_WEIGHT, crossing, count, gradient, pieces, basis, hessians
            )
            count += 1
        model = ClearanceModel(value, spline.points, spline.step, spline.begin, seen.gradient, count, *seen[1:])
        kept = self.constrained
        if here and question.sections.frames.constraints:  # which hold where depends on what was passed by then
            kept = constraint_samples(question.sections, spline.pieces, here, self.count)
        expanded = self.nothing_loaded if loads is None or value == math.inf else loads.linearize(spline, turn, weight)
        return Evaluation(spline, model, expanded, kept, tuple(here), stiffness)

    def cost(self, evaluation: Evaluation, limit_weight: float) -> float:
        """The objective of a motion at a weight of the limits' barrier; infinite where it isn't strictly within."""
        return self._but_clearance(evaluation.spline, limit_weight) + self._of_samples(evaluation)

    def _of_samples(self, evaluation: Evaluation) -> float:
        spline, model, loads, constrained, *_ = evaluation
        kept = constraint_penalty(constrained, spline.points) if len(constrained.frames.kinds) > 0 else 0.0
        return model.value + kept + (load_penalty(loads, spline.points, spline.step) if loads.rows else 0.0)

    def _but_clearance(self, spline: BSpline, limit_weight: float) -> float:
        return self._arrival(spline) + limit_weight * self._barrier(spline)

    def _arrival(self, spline: BSpline) -> float:
        return (spline.step + spline.begin / spline.pieces) / self.unit

    def _barrier(self, spline: BSpline) -> float:
        of_times = time_barrier(self.question.times, spline.begin, spline.duration)
        of_limits: float = self.question.limit_barrier(spline.points, spline.step, self.question.limits)
        return of_limits + of_times

    def lower(self, evaluation: Evaluation, limit_weight: float, steps: int | None = None) -> tuple[BSpline, float]:
        """A motion after some of Newton's steps, and by how much its objective is lower as far as an evaluation tells.

        Args:
            steps: Maximum number of Newton's steps; None: that of the settings.
        """
        spline, rules = evaluation.spline, self.question.rules
        points = spline.points.copy()
        step, begin, taken, gained = self.question.newton_descent(
            evaluation.model,
            evaluation.loads,
            self.ends,
            self.question.limits,
            self.question.times,
            evaluation.constrained,
            rules if steps is None else rules._replace(steps=steps),
            self.unit,
            self.question.longest_step,
            limit_weight,
            spline.step,
            spline.begin,
            points,
            self.buffers,
        )
        return (BSpline(points, step, spline.start, spline.end, begin) if taken > 0 else spline), gained

    def find_lower(
        self, evaluation: Evaluation, spline: BSpline, before: float, limit_weight: float
    ) -> tuple[Evaluation, float] | None:
        """Evaluate a motion of a lower objective, the one given or one closer to the last; None if none is found.

        Returns the evaluation and the objective.

        If the clearance differs from the prediction of the last evaluation, a motion closer to that one is
        tried. The next evaluation's model is stiffer then, and softer where the first motion is better.
        """
        settings, tried = self.question.settings, cast(BSpline | None, spline)
        stiffness = max(settings.least_stiffness, SOFTER * evaluation.stiffness)
        for _ in range(MAX_CLOSER):
            if tried is None:
                return None
            rest = self._but_clearance(tried, limit_weight)
            found = self.evaluate(tried, evaluation.passed, stiffness, before - rest, evaluation)
            if (cost := rest + self._of_samples(found)) < before:
                return found, cost
            stiffness = min(1.0, STIFFER * max(stiffness, evaluation.stiffness))
            tried = self._closer(evaluation.spline, tried)
        return None

    def _closer(self, near: BSpline, far: BSpline) -> BSpline | None:
        """A motion strictly within limits between two that are, closer to the first; None where none is found."""
        for _ in range(TRIES):
            far = near.blend(far, CLOSER)
            if math.isfinite(self._barrier(far)):
                return far
        return None
