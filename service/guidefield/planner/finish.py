"""From a path that was found to the trajectory that is executed: optimise shape and time together, certify it.

What the certificate refuses is optimised again with more weight on the clearance, and more samples. Where that can't be
certified either, the path that was found is taken instead, as fast as a spline through it can be executed. Where that
is refused it is drawn closer to the path, whose straight motions are its limit.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from guidefield.collision.certify.certificate import certify
from guidefield.collision.certify.constraint_certificate import certify_constraints
from guidefield.collision.certify.settings import LIMITS
from guidefield.collision.certify.timed_certificate import certify_timed
from guidefield.collision.certify.verdict import Reason, Verdict
from guidefield.collision.clearance import clearance_at
from guidefield.planner.connect.constrained_tree import Keeper
from guidefield.planner.motion.jerk import parameterize_gently
from guidefield.planner.motion.spline import CubicSpline, interpolate
from guidefield.planner.motion.timing import parameterize
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.motion.waypoints import length_of, polyline
from guidefield.planner.optimize.optimization import Optimized, Outcome as Shaping, optimize
from guidefield.planner.optimize.passages import Passage
from guidefield.planner.optimize.plane_place import PlanePlace
from guidefield.planner.optimize.settings import (
    MANY,
    OPTIMIZATION,
    OptimizationSettings,
    closer,
    constrained,
    free,
    of_many,
)
from guidefield.planner.path_so_far import PathSoFar
from guidefield.planner.start_enclosure import enclosed_start
from guidefield.planner.task.ending import Ending
from guidefield.planner.task.problem import Problem
from guidefield.planner.task.stages import Stages
from guidefield.planner.timed_guide import TimedPath
from guidefield.read_only import ReadOnly
from guidefield.robot.model.spaces import ChartCurves, ChartPoint, ChartPoints

REPAIRS = 12
"""How often the spline is drawn closer to the path where the certificate refused it."""


LAST_JUDGEMENT = 0.1
"""For how long a motion may still be judged when time is up or the run is ended [s]: one that is proven is worth it."""

LOST = "the optimised motion did not cross every guide plane within its polygon"
"""Warning about a motion that is the one that was found therefore."""

HURRIED = "time was up while the motion was optimised: with a longer `allowed_planning_time` it gets better"
"""Warning about a motion that is certified, but slower, or nearer to obstacles, than it had to be."""


@dataclass(frozen=True, eq=False)
class Finished(ReadOnly):
    """A motion at the end of planning, and the certificate's verdict about it.

    Attributes:
        verdict: The certificate's judgement of `trajectory`, or of `path` where there is no trajectory.
        path: Chart points that it runs through, shape (n, nv) [rad or m].
        crossings: By index of each guide plane that was reached, its index in `path`.
        trajectory: What the robot would execute; None where a stage failed before.
        failure: Why a stage failed; None where none did.
        warnings: What was odd but harmless.
        judged_from: Since when the trajectory is judged: before that it leaves a contact at the start [s].
    """

    verdict: Verdict
    path: ChartPoints
    crossings: Mapping[int, int]
    trajectory: Trajectory | None = None
    failure: Ending | None = None
    warnings: tuple[str, ...] = ()
    judged_from: float = 0.0


def finish(problem: Problem, found: PathSoFar, stages: Stages) -> Finished:
    """Make a certified trajectory of a path whose straight pieces are free; judge one that failed as far as it goes.

    Args:
        problem: Robot, world, limits and budget.
        found: The path. Only one that is proven itself is worth a try where the optimised one is refused.
        stages: Where time is counted.
    """
    if found.failure is not None:
        return _as_far_as_it_got(problem, found, found.failure, stages)
    if problem.optimization_iterations == 0 or length_of(found.path) == 0.0:
        return _certified(problem, found.path, found.crossings, stages)
    finished = _optimized(problem, found, stages)
    if finished is not None and (finished.verdict.free or not found.proven):
        return finished
    as_found = _certified(problem, found.path, found.crossings, stages)
    if finished is None:
        return replace(as_found, warnings=(f"{LOST}; this is the motion as it was found",))
    why = finished.verdict.reason
    if not as_found.verdict.free:
        return as_found if why is Reason.CONTACT else finished
    warning = f"the optimised motion was not certified ({why.value}); this is the motion as it was found"
    return replace(as_found, warnings=(warning,))


def found_motion(problem: Problem, found: PathSoFar, stages: Stages) -> Finished:
    """The motion along a path as it was found, as fast as it can be executed; judged as far as it goes.

    Args:
        problem: Robot, world, limits and budget.
        found: The path.
        stages: Where time is counted.
    """
    if found.failure is not None:
        return _as_far_as_it_got(problem, found, found.failure, stages)
    return _certified(problem, found.path, found.crossings, stages)


def finish_timed(problem: Problem, found: TimedPath, stages: Stages) -> Finished:
    """Judge a motion among obstacles that move, whose schedule is the trajectory's.

    Args:
        problem: Robot, world and obstacles.
        found: The motion, or how far it got.
        stages: Where time is counted.
    """
    trajectory, failure = found.trajectory(), found.failure
    whole = "on the exact geometry, in time, between samples too"
    with stages.entered("certify", whole if failure is None else "the motion as far as it got, in time") as stage:
        pieces, times = trajectory.bezier(), trajectory.piece_times()
        verdict = enclosed_start(problem, pieces[0, 0], float(times[0])) or certify_timed(
            problem.timed_world, pieces, times, problem.min_clearance
        )
        stage.outcome = verdict.reason.value
    if failure is not None:
        return Finished(verdict, np.array(found.points), found.crossings, failure=failure)
    problem.counters.collision_checks += verdict.evaluations
    return Finished(verdict, np.array(found.points), found.crossings, trajectory)


def _as_far_as_it_got(problem: Problem, found: PathSoFar, failure: Ending, stages: Stages) -> Finished:
    """The best motion so far, without time, certified as far as it goes."""
    with stages.entered("certify", "the motion as far as it got") as stage:
        verdict = enclosed_start(problem, found.path[0]) or certify(
            problem.world, polyline(found.path), problem.min_clearance
        )
        stage.outcome = verdict.reason.value
    return Finished(verdict, found.path, found.crossings, failure=failure)


def _optimized(problem: Problem, found: PathSoFar, stages: Stages) -> Finished | None:
    """The optimised trajectory from the time-optimal one along the path; where it is refused, optimised again.

    None where it can't be brought onto a guide plane.
    """
    with stages.entered("parameterize", "as fast as the limits allow along the path") as stage:
        motion = soonest_along(problem, found.path)
        stage.outcome = f"{motion.duration:.3f} s"
    others = (soonest_along(problem, path) for path in found.others)
    return optimized_motion(problem, motion, others, stages, found)


def optimized_motion(
    problem: Problem, motion: Trajectory, others: Iterator[Trajectory], stages: Stages, found: PathSoFar | None = None
) -> Finished | None:
    """The optimised trajectory from a motion; where it is refused, optimised again. None where none is to be had.

    Args:
        problem: Robot, world, limits and budget.
        motion: Where it begins.
        others: What may prove quicker, made when it is asked for.
        stages: Where time is counted.
        found: The path with the guide planes that the motion crosses; None: it crosses none.
    """
    crossed = NO_PLANES if found is None else Crossed.of(problem, found.path, found.crossings)
    settings = settings_of(problem, passes=crossed.any)
    with stages.entered("relax", f"shape and time together, {problem.objective.value}") as stage:
        optimized = optimize(problem, motion, settings, others, crossed.passages)
        stage.outcome = optimized.outcome.value
    finished = None
    if optimized.outcome is Shaping.NOT_WITHIN:
        return None
    if optimized.outcome is not Shaping.NOT_PASSING:
        finished = _of_optimized(problem, optimized, crossed, stages)
        if finished.verdict.free:
            return finished
    if problem.budget.spent():
        return finished
    why = "a guide plane was lost" if finished is None else "the certificate refused it"
    with stages.entered("relax", f"again, looking closer, because {why}") as stage:
        optimized = optimize(problem, motion, closer(settings), (), crossed.passages)
        stage.outcome = optimized.outcome.value
    if optimized.outcome in (Shaping.NOT_WITHIN, Shaping.NOT_PASSING):
        return finished
    again = _of_optimized(problem, optimized, crossed, stages)
    return again if finished is None or again.verdict.free else finished


def settings_of(problem: Problem, *, passes: bool = False) -> OptimizationSettings:
    """Of the optimisation of a problem's motion, which may have to pass something on its way."""
    settings = OPTIMIZATION[problem.objective]
    if problem.group.nv > MANY:
        settings = of_many(settings)
    elif not (problem.path_constraints or passes):
        settings = free(settings)
    return constrained(settings) if problem.path_constraints else settings


@dataclass(frozen=True, eq=False)
class Crossed(ReadOnly):
    """The guide planes that an optimised motion crosses.

    Attributes:
        passages: Those that it crosses on its way, in order.
        on_way: Their indices.
        at_ends: By index of each other guide plane that was reached, the knot that stays on it: the first or the last.
    """

    passages: tuple[Passage, ...]
    on_way: tuple[int, ...]
    at_ends: Mapping[int, int]

    @classmethod
    def of(cls, problem: Problem, path: ChartPoints, crossings: Mapping[int, int]) -> Crossed:
        """Of a path (n, nv), and by index of each guide plane that was reached, its index in the path."""
        last = len(path) - 1
        inner = sorted((at, plane) for plane, at in crossings.items() if 0 < at < last)
        return cls(
            tuple(
                Passage(PlanePlace.through(problem, problem.guide_planes[plane], path[at]), path[at])
                for at, plane in inner
            ),
            tuple(plane for _, plane in inner),
            {plane: 0 if at == 0 else -1 for plane, at in crossings.items() if at in (0, last)},
        )

    @property
    def any(self) -> bool:
        """Whether it crosses any on its way."""
        return bool(self.passages)

    def knots(self, optimized: Optimized) -> dict[int, int]:
        """By index of each guide plane, the knot of an optimised trajectory that is on it."""
        last = len(optimized.trajectory.times) - 1
        at_ends = {plane: 0 if at == 0 else last for plane, at in self.at_ends.items()}
        return at_ends | dict(zip(self.on_way, optimized.passed, strict=True))


NO_PLANES = Crossed((), (), {})
"""Of a motion that crosses none."""


def soonest_along(problem: Problem, path: ChartPoints) -> Trajectory:
    """The time-optimal motion along a path (n, nv), whatever its jerk."""
    group = problem.group
    return parameterize(through(problem, path), group.velocity_limits, group.acceleration_limits)


def _of_optimized(problem: Problem, optimized: Optimized, crossed: Crossed, stages: Stages) -> Finished:
    """An optimised trajectory, judged, with a warning where time was up meanwhile."""
    trajectory = optimized.trajectory
    with stages.entered("certify", "on the exact geometry, between samples too") as stage:
        verdict = judged(problem, trajectory.bezier())
        problem.counters.collision_checks += verdict.evaluations
        stage.outcome = verdict.reason.value
    warnings = (HURRIED,) if optimized.outcome is Shaping.OUT_OF_TIME else ()
    return Finished(verdict, trajectory.positions, crossed.knots(optimized), trajectory, warnings=warnings)


def _certified(problem: Problem, path: ChartPoints, crossings: Mapping[int, int], stages: Stages) -> Finished:
    """Time and certify the spline through a path, drawing it closer to the path where it is refused."""
    knots, marks = path, dict(crossings)
    for repair in range(REPAIRS + 1):
        with stages.entered("parameterize", "as fast as the limits allow") as stage:
            spline = through(problem, knots if len(knots) > 1 else np.repeat(knots, 2, axis=0))
            trajectory = timed(problem, spline)
            stage.outcome = f"{trajectory.duration:.3f} s"
        with stages.entered("certify", "on the exact geometry, between samples too") as stage:
            verdict = judged(problem, trajectory.bezier())
            problem.counters.collision_checks += verdict.evaluations
            stage.outcome = verdict.reason.value
        hopeless = repair == REPAIRS or verdict.piece is None or len(knots) < 2
        if verdict.free or hopeless or problem.budget.spent():
            break
        refused = trajectory.bezier()[verdict.piece].mean(axis=0)
        worst, nearest = _nearest(knots, refused)
        if _refused_at(problem, nearest, verdict.reason):
            break  # a spline that is drawn closer would be refused there, too
        knots, marks = _denser(problem, knots, marks, worst)
    return Finished(verdict, knots, marks, trajectory)


def judged(problem: Problem, pieces: ChartCurves) -> Verdict:
    """Whether a motion, pieces (m, 4, nv), is free, and keeps the path constraints."""
    stopped = _at_the_very_end(problem)
    verdict = certify(problem.world, pieces, problem.min_clearance, stopped=stopped)
    if not (verdict.free and problem.path_constraints):
        return verdict
    turns = problem.world.bodies.turns
    kept = certify_constraints(problem.constrained_frames, turns, pieces, stopped)
    return replace(kept, evaluations=verdict.evaluations + kept.evaluations)


def _at_the_very_end(problem: Problem) -> Callable[[], object]:
    """Whether time is up, and what is still allowed for a judgement that begins now has passed too."""
    until = time.monotonic() + LAST_JUDGEMENT
    return lambda: time.monotonic() >= until and problem.budget.spent()


def through(problem: Problem, path: ChartPoints) -> CubicSpline:
    """The spline through a path's chart points (n, nv), n >= 2, that keeps the joints' position limits."""
    return interpolate(path, problem.group.lower, problem.group.upper)


def timed(problem: Problem, spline: CubicSpline) -> Trajectory:
    """The motion along a curve within the problem's limits."""
    group = problem.group
    if problem.jerk_limits is None:
        return parameterize(spline, group.velocity_limits, group.acceleration_limits)
    return parameterize_gently(spline, group.velocity_limits, group.acceleration_limits, problem.jerk_limits)


def _refused_at(problem: Problem, z: ChartPoint, reason: Reason) -> bool:
    """Whether a chart point (nv,) itself is refused for a reason: contact, less than the clearance, beyond limits."""
    match reason:
        case Reason.BEYOND_LIMITS:
            lower, upper = problem.group.lower - LIMITS.tolerance, problem.group.upper + LIMITS.tolerance
            return bool(((z < lower) | (z > upper)).any())
        case Reason.TOO_CLOSE:
            return (
                clearance_at(problem.world, problem.group.expand_from_chart(z)).obstacle_distance
                < problem.min_clearance
            )
        case Reason.CONTACT:
            return problem.world.in_collision(problem.group.expand_from_chart(z))
    return False


def _nearest(path: ChartPoints, place: ChartPoint) -> tuple[int, ChartPoint]:
    """The segment of a path (n, nv) that is nearest to a place (nv,), and the point (nv,) of it that is."""
    along = np.diff(path, axis=0)
    share = np.einsum("ij,ij->i", place - path[:-1], along) / np.maximum(np.einsum("ij,ij->i", along, along), 1e-30)
    nearest = path[:-1] + np.clip(share, 0.0, 1.0)[:, None] * along
    segment = int(np.argmin(np.linalg.norm(place - nearest, axis=1)))
    return segment, nearest[segment]


def _denser(
    problem: Problem, path: ChartPoints, crossings: dict[int, int], worst: int
) -> tuple[ChartPoints, dict[int, int]]:
    """Midpoints inserted into a segment and those next to it, within the path constraints."""
    split = [i for i in range(worst - 1, worst + 2) if 0 <= i < len(path) - 1]
    middles = np.array([0.5 * (path[i] + path[i + 1]) for i in split])
    if problem.path_constraints:
        keeper = Keeper(problem, problem.constrained_frames)
        middles = np.array([middle if (back := keeper.brought_back(middle)) is None else back for middle in middles])
    denser = np.insert(path, np.array(split) + 1, middles, axis=0)
    return denser, {plane: index + sum(index > i for i in split) for plane, index in crossings.items()}
