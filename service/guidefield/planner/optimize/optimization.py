"""Optimise a motion: as fast as its limits allow, far from obstacles, shape and time together.

The motion is a uniform cubic B-spline in time. Its control points P and the logarithm u of the length of its pieces
minimise

    exp(u - u0) + λ · mean over samples of the clearance barrier + μ · logarithmic barrier of its limits

by Newton's method on a banded system with a border for u, while μ falls (an interior point method: Boyd and
Vandenberghe, Convex Optimization, 2004, chapter 11); every motion on the way is within its limits. The clearance is
examined seldom: in between its expansion to second order represents it. Then the pieces are subdivided, which leaves
the curve as it is, and μ falls on. Steps are counted, not timed: the same problem has the same motion whatever the
load, unless time runs out.

The result is a proposal, examined at samples only: the certificate judges it. The constants change motions and time;
`ROOM` and `LOOSENED` are above 1, `STRICTLY` is below, as the limits' barrier is infinite beyond. By it alone motions
keep limits of rates that begin or end in motion: `optimized_motion.py` takes none beyond.
"""

from __future__ import annotations

import dataclasses
import enum
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, cast

import numpy as np

from guidefield.errors import Status
from guidefield.kernels.optimize.limit_barrier import MotionLimits, TimeLimits
from guidefield.planner.motion.bspline import ENDS, BSpline, End
from guidefield.planner.motion.limit_load import stretch_to_limits
from guidefield.planner.motion.timing import length_of
from guidefield.planner.motion.trajectory import ROUNDING, Trajectory
from guidefield.planner.optimize.clearance_samples import (
    Sections,
    TouchedPoint,
    few_points,
    kept_at,
    sampled_robot,
    with_points,
)
from guidefield.planner.optimize.interior_point import Evaluation, LoadSamples, OptimizationProblem, PenalizedObjective
from guidefield.planner.optimize.passages import Passage, first_places, move_onto_places, with_knots
from guidefield.planner.optimize.settings import OptimizationSettings
from guidefield.planner.task.problem import Problem
from guidefield.planner.task.trace import Note, PathRelaxed
from guidefield.read_only import ReadOnly, read_only
from guidefield.robot.model.joints import LocalPoints, LocalRate
from guidefield.scene.distance_tables import distance_tables, moving_tables

MOST_STEPS = 20  # most evaluations that bring something at each weight: easy motions take four, a Fetch's twenty
# pieces of the first motion are longer by this factor than its limits allow: with 1 nothing is optimised. Unrecorded
ROOM = 1.02
INSIDE = 1e-3  # share of a coordinate's range that the first motion keeps from its ends, above 0. Unrecorded
MOST_MOVING_PIECES = 192  # most pieces of a motion that begins or ends in motion. Unrecorded
STOP_PIECES = 4  # least of its pieces for coming to rest there. Unrecorded
LOOSENINGS = 8  # rounds of loosened limits by which such a motion is brought within. Unrecorded
LOOSENED = 1.1  # loosened limits over what the motion takes of them. Unrecorded
INWARD = 0.1  # weight of the limits' barrier then. Unrecorded
INWARD_STEPS = 3  # Newton's steps in each round. Unrecorded
STRICTLY = 0.995  # share of the limits within which such a motion may begin. Unrecorded
STRAIGHT_PIECES = 16  # pieces of the straight motion by which the least time is estimated


def motion_limits(problem: Problem) -> MotionLimits:
    """The limits of a problem's motions, for the kernels."""
    group = problem.group
    jerk = np.full(group.nv, np.inf) if problem.jerk_limits is None else problem.jerk_limits
    if problem.in_motion or problem.scene.moves:  # its time can't be scaled in the end
        jerk = (1.0 - ROUNDING) * jerk
    rows = (group.velocity_limits, group.acceleration_limits, jerk, group.lower, group.upper, group.sizes)
    limits = MotionLimits(*(np.array(row, float) for row in rows))
    read_only(*limits)
    return limits


def ends_of(problem: Problem, motion: Trajectory) -> tuple[End, End]:
    """The states in which a problem's motion begins and ends, where another one does."""
    start, end = motion.positions[0].copy(), motion.positions[-1].copy()
    rise = problem.start_acceleration
    still = cast(LocalRate, np.zeros(problem.group.nv))
    return End(start, problem.start_rates.copy(), still if rise is None else rise.copy()), End(
        end, problem.end_rates.copy(), still
    )


def first_motion(motion: Trajectory, limits: MotionLimits, settings: OptimizationSettings) -> BSpline:
    """A spline near a motion from rest to rest, strictly within limits; slower where it has to be."""
    return _fit_spline(motion, _pieces(motion, limits, settings), limits)


def slow_down(spline: BSpline, problem: Problem) -> BSpline:
    """A spline from rest to rest, slower where limits of speed in space need it on its path."""
    if not problem.cartesian_limits:
        return spline
    samples = LoadSamples.of(problem.cartesian_limits, spline.pieces, problem.group.nv)
    stretch = max(1.0, samples.mean(spline))
    return BSpline.between(spline.start, spline.end, spline.inner, stretch * spline.step)


def scheduled_motion(
    motion: Trajectory, limits: MotionLimits, settings: OptimizationSettings, arrive_from: float
) -> BSpline:
    """A spline near a motion from rest to rest that keeps a schedule, strictly within limits, and arrives after a time.

    It takes as long, or longer where that is too fast, or too soon. Where it is fastest its pieces are as short as
    those of a motion that speeds up and brakes all the way.
    """
    begin = float(motion.times[0])
    fastest = float(np.linalg.norm(motion.velocities / limits.sizes, axis=1).max())
    pieces = int(np.ceil(0.5 * fastest * motion.duration / settings.piece))
    spline = _fit_spline(motion, int(np.clip(pieces, settings.least_pieces, settings.most_pieces)), limits)
    step = max(spline.step, max(motion.duration, ROOM * (arrive_from - begin)) / spline.pieces)
    return BSpline.between(spline.start, spline.end, spline.inner, step, begin)


def moving_motion(
    motion: Trajectory, ends: tuple[End, End], limits: MotionLimits, settings: OptimizationSettings
) -> BSpline:
    """A spline near a motion that begins or ends in motion, in short pieces; not yet within limits."""
    speeds = np.maximum(*(np.abs(end.velocity) for end in ends))
    stop = float((speeds / limits.acceleration).max()) / STOP_PIECES
    step = min(motion.duration / _pieces(motion, limits, settings), 0.5 * longest_step(ends, limits))
    step = min(step, stop) if stop > 0.0 else step
    pieces = int(np.clip(np.ceil(motion.duration / step), settings.least_pieces, MOST_MOVING_PIECES))
    step = motion.duration / pieces
    times = motion.times[0] + step * np.arange(2, pieces - 1)
    return BSpline.between(*ends, _with_room(motion.evaluate(times)[0], limits), step)


def longest_step(ends: tuple[End, End], limits: MotionLimits) -> float:
    """The largest length of pieces for ends that still speed up: the first velocity is v + a h / 2 [s]."""
    longest = np.inf
    for end in ends:
        rises = end.velocity * end.acceleration > 0.0
        room = (limits.velocity - np.abs(end.velocity))[rises]
        longest = min(longest, float((2.0 * room / np.abs(end.acceleration[rises])).min(initial=np.inf)))
    return longest


def _fit_spline(motion: Trajectory, pieces: int, limits: MotionLimits) -> BSpline:
    """A spline of some pieces through samples of a motion evenly in time, as fast as it may be with some room."""
    inner = pieces - ENDS  # the ends take the places before and after them
    times = motion.times[0] + motion.duration * np.arange(1, inner + 1) / (inner + 1)
    points = _with_room(motion.evaluate(times)[0], limits)
    start, end = End.at_rest(motion.positions[0].copy()), End.at_rest(motion.positions[-1].copy())
    step = ROOM * shortest_step(BSpline.between(start, end, points, 1.0).points, limits)
    return BSpline.between(start, end, points, step)


def _pieces(motion: Trajectory, limits: MotionLimits, settings: OptimizationSettings) -> int:
    length = length_of(motion.positions, limits.sizes)
    return int(np.clip(np.ceil(length / settings.piece), settings.least_pieces, settings.most_pieces))


def _with_room(points: LocalPoints, limits: MotionLimits) -> LocalPoints:
    room = np.where(np.isfinite(limits.upper - limits.lower), INSIDE * (limits.upper - limits.lower), 0.0)
    within = points.copy()
    np.clip(points, limits.lower + room, limits.upper - room, out=within)
    return within


def load_of(spline: BSpline, limits: MotionLimits) -> float:
    """The largest share of a limit that a spline's inner differences take: below 1 it is strictly within limits."""
    load, differences = 0.0, spline.points
    for order, limit in enumerate((limits.velocity, limits.acceleration, limits.jerk), 1):
        differences = np.diff(differences, axis=0)
        given = ENDS - order  # the ends' own
        inner = differences[given : len(differences) - given]
        load = max(load, float((np.abs(inner) / (limit * spline.step**order)).max()))
    return load


def shortest_step(points: LocalPoints, limits: MotionLimits) -> float:
    """The length of pieces with which control points (n, nv) reach the limits of their ratios [s]."""
    first = np.diff(points, axis=0)
    second = np.diff(first, axis=0)
    third = np.diff(second, axis=0)
    return max(
        float((np.abs(first) / limits.velocity).max()),
        float(np.sqrt((np.abs(second) / limits.acceleration).max())),
        float(np.cbrt((np.abs(third) / limits.jerk).max())),
    )


class Outcome(enum.Enum):
    """The outcome of an optimisation."""

    OPTIMISED = "optimised"
    OUT_OF_ITERATIONS = "out of iterations"
    OUT_OF_TIME = "out of time"
    STOPPED = "stopped"
    NOT_WITHIN = "no motion within limits was found that begins and ends in motion"
    NOT_PASSING = "a guide plane was lost"


_ENDINGS = {Status.TIMED_OUT: Outcome.OUT_OF_TIME, Status.PREEMPTED: Outcome.STOPPED}


@dataclass(frozen=True, eq=False)
class Optimized(ReadOnly):
    """An optimised motion."""

    trajectory: Trajectory  # within every limit of velocity, acceleration, jerk and position
    steps: int
    before: float  # duration of the motion with which it began [s]
    outcome: Outcome
    passed: tuple[int, ...] = ()


def optimize(
    problem: Problem,
    motion: Trajectory,
    settings: OptimizationSettings,
    others: Iterable[Trajectory] = (),
    passages: tuple[Passage, ...] = (),
    sections: Sections | None = None,
    leave_by: float = 0.0,
    arrive_from: float = -math.inf,
    touched: Sequence[TouchedPoint] = (),
) -> Optimized:
    """Optimise a motion that goes along a path that was found, within the problem's deadline and its number of steps.

    Among obstacles that move each is where it is at the time. A motion that begins later than at time 0 may then begin
    at another time, but one that begins at 0 begins there.

    Its ends stay bit for bit. One that begins or ends in motion may prove to have no spline within limits: it stays as
    it is, and the outcome says so. So does one that can't be brought exactly to where it has to pass.

    Args:
        motion: With the problem's velocities at its ends, not a single point, within position limits.
        others: Others from the same start, made lazily. They are optimised coarsely, one after the
            other, while the best is far from the least time; the best goes on.
        passages: What the motion passes at times that are free, in this order; all motions given go through their
            waypoints. None where it begins or ends in motion.
        sections: Path constraints, and where they hold; None: those of the problem, all along.
        leave_by: It begins before this [s], if it begins later than at 0.
        arrive_from: It ends after this [s].
        touched: Points of the robot at which such motions were refused, which are examined as well.
    """
    kept = Sections.whole(problem.constrained_frames, len(passages)) if sections is None else sections
    descending = _Descending(problem, settings, passages, kept, (leave_by, arrive_from), touched)
    best = descending.coarse(motion)
    rest = iter(others)
    while descending.outcome is None and not (
        best and (spline := best.found.evaluation.spline).duration <= settings.enough * least_time(problem, spline)
    ):
        other = next(rest, None)
        if other is None:
            break
        best = min(filter(None, (best, descending.coarse(other))), key=lambda one: one.cost, default=None)
    if best is None:
        problem.counters.iterations += descending.steps
        return Optimized(motion, descending.steps, motion.duration, Outcome.NOT_WITHIN)
    evaluation = descending.fine(best)
    problem.counters.iterations += descending.steps
    exact = move_onto_places(evaluation.spline, passages, evaluation.passed, best.question.limits.sizes)
    if exact is None:
        return Optimized(motion, descending.steps, motion.duration, Outcome.NOT_PASSING)
    spline, places = exact
    knots, passed = with_knots(spline, places)
    limits = best.question.limits
    if problem.in_motion or problem.scene.moves:  # its time can't be scaled, and need not be: it is within limits
        times, positions, velocities = knots
        trajectory = Trajectory(spline.begin + times, positions, velocities)
    else:
        rates = limits.velocity, limits.acceleration, limits.jerk
        trajectory = stretch_to_limits(*knots, *rates, problem.motion_limits, problem.deadline)
    steps, outcome = descending.steps, descending.outcome or Outcome.OPTIMISED
    problem.tell(Note(f"optimised in {steps} steps: {motion.duration:.3f} s became {trajectory.duration:.3f} s"))
    return Optimized(trajectory, steps, motion.duration, outcome, passed)


class _Descended(NamedTuple):
    evaluation: Evaluation
    cost: float  # its objective
    ahead: BSpline  # a motion that the evaluation promises to be better, by less than another one is worth

    def finer(self) -> tuple[BSpline, tuple[float, ...]]:
        """That one in twice the pieces, and where it comes nearest to each passage."""
        return self.ahead.subdivide(), tuple(2.0 * at for at in self.evaluation.passed)


@dataclass(frozen=True, eq=False)
class _Coarse(ReadOnly):
    question: OptimizationProblem
    found: _Descended
    cost: float  # its objective, as a time [s]


class _Descending:
    """An optimisation under way: the number of its steps, and what ended it, if anything did."""

    def __init__(
        self,
        problem: Problem,
        settings: OptimizationSettings,
        passages: tuple[Passage, ...],
        sections: Sections,
        between: tuple[float, float],
        touched: Sequence[TouchedPoint],
    ) -> None:
        self._touched = touched
        self._problem, self._settings, self._passages, self._sections = problem, settings, passages, sections
        self._leave_by, self._arrive_from = between
        self._limits, self._tables = motion_limits(problem), distance_tables(problem.scene)
        self._moving = moving_tables(problem.scene)
        self.steps = 0
        self.outcome: Outcome | None = None

    def coarse(self, motion: Trajectory) -> _Coarse | None:
        """A motion after all weights but the fine ones; None where it can't be brought within limits."""
        problem, tables, ends = self._problem, self._tables, motion.positions[[0, -1]]
        robot = with_points(problem, sampled_robot(problem, tables, ends), self._touched)
        kept = [kept_at(problem, robot, z, at) for z, at in zip(ends, motion.times[[0, -1]].tolist(), strict=True)]
        moving, longest = ends_of(problem, motion), np.inf
        if problem.in_motion:
            first = moving_motion(motion, moving, self._limits, self._settings)
            longest = longest_step(moving, self._limits)
        elif problem.scene.moves:
            first = scheduled_motion(motion, self._limits, self._settings, self._arrive_from)
        else:
            first = slow_down(first_motion(motion, self._limits, self._settings), problem)
        question = OptimizationProblem(
            robot,
            tables,
            self._moving,
            self._sections,
            self._limits,
            (kept[0], kept[1]),
            problem.min_clearance,
            first.duration,
            self._settings,
            TimeLimits(int(first.begin > 0.0), self._leave_by, self._arrive_from, first.duration),
            longest,
            self._passages,
            problem.motion_limits,
        )
        within = brought_within(question, first) if problem.in_motion else first
        if within is None:
            return None
        passed = first_places(self._passages, motion, within.pieces, self._limits.sizes)
        settings, begun = self._settings, (within, passed)
        coarse = question
        if self._passages:  # links of chains have many points, and through a gate all of them are near something
            coarse = dataclasses.replace(question, robot=few_points(robot))
        if settings.rough:
            begun = self._descend(coarse, *begun, settings.rough, settings.samples).finer()
        found = self._descend(coarse, *begun, settings.coarse, settings.samples)
        return _Coarse(coarse if settings.few else question, found, question.duration * found.cost)

    def fine(self, coarse: _Coarse) -> Evaluation:
        if self.outcome is not None:
            return coarse.found.evaluation
        settings = self._settings
        return self._descend(coarse.question, *coarse.found.finer(), settings.fine, settings.fine_samples).evaluation

    def _descend(
        self,
        question: OptimizationProblem,
        spline: BSpline,
        passed: tuple[float, ...],
        weights: Sequence[float],
        samples: int,
    ) -> _Descended:
        """The motion after some weights of the limits' barrier, with some samples on a piece."""
        settings, descent = self._settings, PenalizedObjective.of(question, spline, samples)
        evaluation, cost, ahead = descent.evaluate(spline, passed, settings.stiffness), np.inf, spline
        for limit_weight in weights:
            cost, worth = descent.cost(evaluation, limit_weight), settings.worth * math.sqrt(limit_weight)
            for _ in range(MOST_STEPS):
                self.outcome = self._find_outcome()
                if self.outcome is not None:
                    return _Descended(evaluation, cost, ahead)
                ahead, promised = descent.lower(evaluation, limit_weight)
                if promised <= worth * abs(cost):
                    break
                stepped, ahead = descent.find_lower(evaluation, ahead, cost, limit_weight), evaluation.spline
                if stepped is None:
                    break
                before, (evaluation, cost) = cost, stepped
                ahead = evaluation.spline
                self.steps += 1
                if self._problem.is_observed:
                    self._problem.tell(PathRelaxed(evaluation.spline.waypoints(), cost))
                if before - cost < worth * abs(before):
                    break
        return _Descended(evaluation, cost, ahead)

    def _find_outcome(self) -> Outcome | None:
        if (status := self._problem.deadline.status()) is not None:
            return _ENDINGS[status]
        most = self._problem.optimization_iterations
        return Outcome.OUT_OF_ITERATIONS if most is not None and self.steps >= most else None


def least_time(problem: Problem, spline: BSpline) -> float:
    """The time of a straight motion between the same ends: of the joint that alone needs longest by its limits [s].

    By limits of speed in space that of their straight motion of all joints together.
    """
    offset = np.abs(spline.end.position - spline.start.position)
    top, rise = problem.group.velocity_limits, problem.group.acceleration_limits
    longest = float(np.where(offset > top**2 / rise, offset / top + top / rise, 2.0 * np.sqrt(offset / rise)).max())
    if not problem.cartesian_limits:
        return longest
    shares = np.linspace(0.0, 1.0, STRAIGHT_PIECES - 1)[1:-1, None]
    inner = cast(LocalPoints, spline.start.position + shares * (spline.end.position - spline.start.position))
    straight = BSpline.between(End.at_rest(spline.start.position), End.at_rest(spline.end.position), inner, 1.0)
    samples = LoadSamples.of(problem.cartesian_limits, straight.pieces, problem.group.nv)
    return max(longest, samples.mean(straight) * straight.duration)


def brought_within(question: OptimizationProblem, spline: BSpline) -> BSpline | None:
    """The motion strictly within limits; None where that isn't reached in a few rounds."""
    settings = question.settings
    for _ in range(LOOSENINGS):
        load = load_of(spline, question.limits)
        if load < STRICTLY:
            return spline
        by, limits = LOOSENED * load, question.limits
        rows = by * limits.velocity, by * limits.acceleration, by * limits.jerk
        read_only(*rows)
        loosened = limits._replace(velocity=rows[0], acceleration=rows[1], jerk=rows[2])
        descent = PenalizedObjective.of(dataclasses.replace(question, limits=loosened), spline, settings.samples)
        spline, _ = descent.lower(descent.evaluate(spline), INWARD, INWARD_STEPS)
    return None
