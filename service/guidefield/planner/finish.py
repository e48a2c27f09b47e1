"""From a path that was found to the trajectory that is executed: optimise shape and time together, certify it.

What the certificate refuses is optimised again with more weight on the clearance, and more samples. Where that can't be
certified either, the path that was found is taken instead, as fast as it can be executed round its corners. Where that
is refused the motion is drawn closer to the path. In the end it stops at every corner: then it is the path itself.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import cast

import numpy as np

from guidefield.collision.clearance import clearance_at
from guidefield.planner.connect.settings import TREE
from guidefield.planner.motion.limit_load import at_limits
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.motion.waypoints import distinct, polyline
from guidefield.planner.optimize.optimization import Optimized, Outcome as Shaping, optimize
from guidefield.planner.optimize.passages import Passage, first_places, passing, with_knots
from guidefield.planner.optimize.plane_place import PlanePlace
from guidefield.planner.optimize.settings import (
    MANY,
    OPTIMIZATION,
    OptimizationSettings,
    closer,
    constrained,
    free,
    guided,
    guided_of_many,
    in_few_pieces,
    of_many,
)
from guidefield.planner.path_motion import limits_of, motion_along, rounded_spline, soonest_along, stopping_along
from guidefield.planner.quality import certify_and_measure
from guidefield.planner.settings import STRAIGHT_WAYS
from guidefield.planner.start_enclosure import enclosed_start
from guidefield.planner.task.ending import Ending
from guidefield.planner.task.problem import Problem
from guidefield.planner.task.stages import PathSoFar, Stages
from guidefield.prove.certificate import certify
from guidefield.prove.constraint_certificate import certify_constraints
from guidefield.prove.settings import LIMITS
from guidefield.prove.verdict import Reason, Verdict
from guidefield.read_only import ReadOnly
from guidefield.robot.model.spaces import ChartPoint, ChartPoints

REPAIRS = 4
"""How often a motion round corners is drawn closer to the path, to half its distance each time, where it is refused."""

LAST_JUDGEMENT = 0.03
"""For how long a motion may still be judged when time is up or the run is ended [s]: one that is proven is worth it."""

LOST = "the optimised motion did not cross every guide plane within its polygon"
"""Warning about a motion that is the one that was found therefore."""

STOPPING = "no motion round the corners of the path was certified: this one stops at each of them"
"""Warning about a motion that is slower therefore."""

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
        problem: Robot, world, limits and deadline.
        found: The path. Only one that is proven itself is worth a try where the optimised one is refused.
        stages: Where time is counted.
    """
    if found.failure is not None:
        return _as_far_as_it_got(problem, found, found.failure, stages)
    if problem.optimization_iterations == 0 or len(distinct(found.path)) == 1:
        return _along(problem, found, stages)
    finished = _optimized(problem, found, stages)
    if finished is not None and (finished.verdict.free or not found.proven):
        return finished
    as_found = _along(problem, found, stages)
    if finished is None:
        return _warned(as_found, f"{LOST}; this is the motion as it was found")
    why = finished.verdict.reason
    if not as_found.verdict.free:
        return as_found if why is Reason.CONTACT else finished
    return _warned(
        as_found, f"the optimised motion was not certified ({why.value}); this is the motion as it was found"
    )


def found_motion(problem: Problem, found: PathSoFar, stages: Stages) -> Finished:
    """The motion along a path as it was found, as fast as it can be executed; judged as far as it goes.

    Args:
        problem: Robot, world, limits and deadline.
        found: The path.
        stages: Where time is counted.
    """
    if found.failure is not None:
        return _as_far_as_it_got(problem, found, found.failure, stages)
    return _along(problem, found, stages)


def _as_far_as_it_got(problem: Problem, found: PathSoFar, failure: Ending, stages: Stages) -> Finished:
    """The best motion so far, without time, certified as far as it goes."""
    with stages.entered("certify", "the motion as far as it got") as stage:
        verdict = enclosed_start(problem, found.path[0]) or certify(
            problem.world,
            polyline(found.path),
            problem.min_clearance,
            deadline=problem.deadline.at_least(LAST_JUDGEMENT),
        )
        stage.outcome = verdict.reason.value
    return Finished(verdict, found.path, found.crossings, failure=failure)


def _optimized(problem: Problem, found: PathSoFar, stages: Stages) -> Finished | None:
    """The optimised trajectory from the time-optimal one along the path; where it is refused, optimised again.

    None where it can't be brought onto a guide plane.
    """

    def soonest(path: ChartPoints) -> Trajectory:
        return soonest_along(problem, fewer_waypoints(problem, path, found.crossings) if found.crossings else path)

    with stages.entered("parameterize", "as fast as the limits allow along the path") as stage:
        motion = soonest(found.path)
        stage.outcome = f"{motion.duration:.3f} s"
    others = (soonest(path) for path in found.others)
    return optimized_motion(problem, motion, others, stages, found)


def optimized_motion(
    problem: Problem, motion: Trajectory, others: Iterator[Trajectory], stages: Stages, found: PathSoFar | None = None
) -> Finished | None:
    """The optimised trajectory from a motion; where it is refused, optimised again. None where none is to be had.

    Args:
        problem: Robot, world, limits and deadline.
        motion: Where it begins.
        others: What may prove quicker, made when it is asked for.
        stages: Where time is counted.
        found: The path with the guide planes that the motion crosses; None: it crosses none.
    """
    crossed = NO_PLANES if found is None else Crossed.of(problem, found.path, found.crossings)
    settings = settings_of(problem, passes=bool(crossed.passages))
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
    if problem.deadline.expired():
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
    settings, many = OPTIMIZATION[problem.objective], problem.group.nv > MANY
    if problem.path_constraints:
        return constrained(of_many(settings) if many else settings)
    if passes:
        return guided_of_many(settings) if many else guided(settings)
    if many:
        return of_many(settings)
    return free(settings) if problem.in_motion or problem.scene.moves else in_few_pieces(free(settings))


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

    def knots(self, trajectory: Trajectory, passed: Sequence[int]) -> dict[int, int]:
        """By index of each guide plane, the knot of a trajectory that is on it.

        Args:
            trajectory: The trajectory.
            passed: Its knots at the passages.
        """
        last = len(trajectory.times) - 1
        at_ends = {plane: 0 if at == 0 else last for plane, at in self.at_ends.items()}
        return at_ends | dict(zip(self.on_way, passed, strict=True))


NO_PLANES = Crossed((), (), {})
"""Of a motion that crosses none."""


def _of_optimized(problem: Problem, optimized: Optimized, crossed: Crossed, stages: Stages) -> Finished:
    """An optimised trajectory, judged, with a warning where time was up meanwhile."""
    warnings = (HURRIED,) if optimized.outcome is Shaping.OUT_OF_TIME else ()
    trajectory = optimized.trajectory
    certified = _certified(problem, trajectory, crossed.knots(trajectory, optimized.passed), stages)
    return replace(certified, warnings=warnings)


def _along(problem: Problem, found: PathSoFar, stages: Stages) -> Finished:
    """The certified motion round the corners of a path, drawn closer to it where it is refused; else with stops."""
    crossed, finished = Crossed.of(problem, found.path, found.crossings), None
    for repair in range(REPAIRS + 1):
        with stages.entered("parameterize", "as fast as the limits allow, round the corners") as stage:
            made = _rounded(problem, found.path, crossed, 2**repair)
            stage.outcome = LOST if made is None else f"{made[0].duration:.3f} s"
        if made is None:
            continue
        finished = _certified(problem, *made, stages)
        if finished.verdict.free or _is_hopeless(problem, found.path, finished) or problem.deadline.expired():
            return finished
    with stages.entered("parameterize", "as fast as the limits allow, with a stop at each corner") as stage:
        trajectory, knots = stopping_along(problem, found.path)
        stage.outcome = f"{trajectory.duration:.3f} s"
    stopping = _certified(problem, trajectory, {plane: knots[at] for plane, at in found.crossings.items()}, stages)
    return _warned(stopping, STOPPING) if finished is None or stopping.verdict.free else finished


def _rounded(
    problem: Problem, path: ChartPoints, crossed: Crossed, finer: int
) -> tuple[Trajectory, dict[int, int]] | None:
    """The motion round the corners of a path, and its knot on each guide plane; None where it misses one.

    Args:
        problem: The robot and its limits.
        path: Chart points, shape (n, nv).
        crossed: The guide planes.
        finer: How many times as close it keeps to the path.
    """
    if not crossed.passages:
        trajectory = motion_along(problem, path, finer)
        return trajectory, crossed.knots(trajectory, ())
    limits = limits_of(problem)
    spline = rounded_spline(problem, path, limits, finer)
    about = first_places(crossed.passages, Trajectory(*spline.knots()), spline.pieces)
    exact = passing(spline, crossed.passages, about)
    if exact is None:
        return None
    knots, passed = with_knots(*exact)
    trajectory = at_limits(*knots, *limits)
    return trajectory, crossed.knots(trajectory, passed)


def _certified(problem: Problem, trajectory: Trajectory, crossings: Mapping[int, int], stages: Stages) -> Finished:
    """A trajectory, judged."""
    with stages.entered("certify", "on the exact geometry, between samples too") as stage:
        verdict = judged(problem, trajectory)
        problem.counters.collision_checks += verdict.evaluations
        stage.outcome = verdict.reason.value
    return Finished(verdict, trajectory.positions, crossings, trajectory)


def _warned(finished: Finished, warning: str) -> Finished:
    """The same with one more warning, the first."""
    return replace(finished, warnings=(warning, *finished.warnings))


def judged(problem: Problem, trajectory: Trajectory) -> Verdict:
    """Judge whether a motion among obstacles at rest is free, and keeps the path constraints."""
    deadline = problem.deadline.at_least(LAST_JUDGEMENT)
    verdict = certify_and_measure(trajectory, problem, deadline)
    if not (verdict.free and problem.path_constraints):
        return verdict
    turns = problem.world.bodies.turns
    kept = certify_constraints(problem.constrained_frames, turns, trajectory.bezier(), deadline)
    return replace(kept, evaluations=verdict.evaluations + kept.evaluations)


def _is_hopeless(problem: Problem, path: ChartPoints, finished: Finished) -> bool:
    """Return whether a motion was refused where the path (n, nv) itself is: drawn closer to it, it would be, too."""
    verdict = finished.verdict
    if verdict.piece is None or len(path) < 2:
        return True
    assert finished.trajectory is not None, "it was judged"
    place = finished.trajectory.bezier()[verdict.piece].mean(axis=0)
    return _refused_at(problem, _nearest(path, place), verdict.reason)


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


def _nearest(path: ChartPoints, place: ChartPoint) -> ChartPoint:
    """The point (nv,) of a path (n, nv) that is nearest to a place (nv,)."""
    along = np.diff(path, axis=0)
    share = np.einsum("ij,ij->i", place - path[:-1], along) / np.maximum(np.einsum("ij,ij->i", along, along), 1e-30)
    nearest = path[:-1] + np.clip(share, 0.0, 1.0)[:, None] * along
    return cast(ChartPoint, nearest[int(np.argmin(np.linalg.norm(place - nearest, axis=1)))])


def fewer_waypoints(problem: Problem, path: ChartPoints, crossings: Mapping[int, int]) -> ChartPoints:
    """A path with the same ends, no longer, through the same waypoints on guide planes.

    Between them straight ways are taken that keep a distance from obstacles; where there is none the path stays.

    Args:
        problem: Robot and world.
        path: Chart points, shape (n, nv).
        crossings: By index of each guide plane that was reached, its index in the path.
    """
    if problem.path_constraints:  # which a straight way would leave
        return path
    kept = sorted({0, len(path) - 1, *crossings.values()})
    margin = problem.min_clearance + STRAIGHT_WAYS.margin
    ways = [problem.lanes.shortened(path[begin : end + 1], TREE.resolution, margin) for begin, end in pairwise(kept)]
    return np.concatenate([path[:1], *(way[1:] for way in ways)])
