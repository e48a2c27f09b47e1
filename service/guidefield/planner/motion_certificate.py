"""The certificate's verdict about a plan's motion, or about the curve that a controller draws from its rows.

What plans and sequences call certified is what `judge` says here: free (`prove/`), within the path constraints and,
of a drawn curve, within the limits of rates. Numbers of rows and of attempts change how often a motion is refused or
slowed down, never the verdict about one; `CERTIFY_GRACE_S` is of the 50 ms that docs/service.md lets answers be late.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from guidefield.collision.clearance import find_enclosed_pair
from guidefield.collision.world import World
from guidefield.deadline import Deadline
from guidefield.errors import Status
from guidefield.memo import MISSING, Answers, memoized
from guidefield.messages.execution import MOST_SENT_ROWS
from guidefield.planner.motion.drawn_motion import DrawnMotion, draw_plan
from guidefield.planner.motion.limit_load import measure_limit_shares
from guidefield.planner.motion.submitted_motion import CurveKind, SubmittedMotion
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.path_so_far import PathSoFar
from guidefield.planner.quality import certify_and_measure
from guidefield.planner.task.effort import EffortLimit, Efforts, measure_efforts
from guidefield.planner.task.motion_limits import CartesianLimit, CartesianUse, MotionLimit, measure_cartesian
from guidefield.planner.task.problem import Conditions, ControllerModel, Interpolation, Problem
from guidefield.planner.task.stages import Ending, Stages
from guidefield.prove.certificate import certify, certify_constraints, judge_limits
from guidefield.prove.curve import point_on
from guidefield.prove.verdict import Reason, Verdict, first_refused
from guidefield.read_only import ReadOnly
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.model.configuration import LimitFault
from guidefield.robot.model.joints import LocalCurves, LocalPoint, LocalPoints, LocalRates

CERTIFY_GRACE_S = 0.03
"""Time to judge a motion after the deadline, or when the run is cancelled [s]: a proven motion is worth it."""

MOST_PARTS = 64
"""Most parts of a span between knots, by which rows are added until the drawn curve is certified: docs/execution.md."""
REFINED = 0.5  # twice the rows must leave no more than this share of an excess, or the motion is slowed down. A choice
MOST_SLOWED = 8  # most times, at least 1, that a motion is slowed down, by 1e-9 more, then by ten times that each time


@dataclass(frozen=True, eq=False)
class CertifiedMotion(ReadOnly):
    """A motion at the end of planning, and the certificate's verdict about it."""

    verdict: Verdict  # the certificate's judgement of `trajectory`, or of `path` where there is no trajectory
    path: LocalPoints  # local coordinates that it runs through, shape (n, nv) [rad or m]
    crossings: Mapping[int, int]  # by index of each guide plane that was reached, its index in `path`
    trajectory: Trajectory | None = None  # what the robot would execute; None where a stage failed before
    failure: Ending | None = None  # why a stage failed; None where none did
    warnings: tuple[str, ...] = ()
    judged_from: float = 0.0  # since when the certificate holds: before that a contact at the start is left [s]


def judge(problem: Problem, trajectory: Trajectory) -> Verdict:
    """Judge whether a motion from a free start is free of what rests and what moves, and keeps the path constraints."""
    deadline = problem.deadline.at_least(CERTIFY_GRACE_S)
    if problem.execution is not None:
        chosen = choose_execution(problem, trajectory)
        return _at_same_times(chosen.verdict, chosen.drawn.motion, trajectory)
    pieces, times = trajectory.bezier(), trajectory.piece_times()
    if problem.scene.moves:  # a better one may follow, so that only the last is measured
        verdict = certify(problem.world, pieces, problem.min_clearance, deadline=deadline, times=times)
    else:
        verdict = certify_and_measure(trajectory, problem, deadline)
    return _with_constraints(problem, verdict, pieces, deadline)


def judge_itself(problem: Problem, trajectory: Trajectory) -> Verdict:
    """Judge a part of a motion, as `judge`: by itself, within the tolerance, whatever a controller draws of it."""
    if problem.execution is None:
        return judge(problem, trajectory)
    motion = SubmittedMotion.of(trajectory, problem.execution.tube)
    return judge_drawn(problem, motion, problem.deadline.at_least(CERTIFY_GRACE_S))[0]


def _at_same_times(verdict: Verdict, submitted: SubmittedMotion, trajectory: Trajectory) -> Verdict:
    """Return a verdict about one motion with its places on the pieces of another, by their times."""
    if verdict.piece is None or verdict.parameter is None or verdict.free_until is None:
        return verdict
    times, places = trajectory.piece_times(), []
    for place in ((verdict.piece, verdict.parameter), verdict.free_until):
        time = submitted.along(*place)[1]
        assert time is not None, "a controller draws in time"
        piece = int(np.clip(np.searchsorted(times, time, "right") - 1, 0, len(times) - 2))
        span = times[piece + 1] - times[piece]  # none of a motion that goes nowhere
        places.append((piece, float(np.clip((time - times[piece]) / span, 0.0, 1.0)) if span > 0.0 else 0.0))
    return replace(verdict, piece=places[0][0], parameter=places[0][1], free_until=places[1])


@dataclass(frozen=True, eq=False)
class ChosenExecution(ReadOnly):
    """The rows that a controller is sent of a motion, and the certificate's verdict about the drawn curve."""

    drawn: DrawnMotion
    verdict: Verdict
    stretch: float = 1.0  # the factor by which the time has to be stretched, where it is above 1, to keep all limits

    @property
    def is_kept(self) -> bool:
        """True if it is free, and within all limits."""
        return self.verdict.free and self.stretch <= 1.0


_CHOSEN = Answers[tuple[ChosenExecution, "weakref.ref[World]"]](1)
"""The last execution that was chosen, by its trajectory, and its world."""

JudgeDrawn = Callable[[SubmittedMotion], tuple[Verdict, float]]  # tells the verdict, and `ChosenExecution.stretch`


def choose_execution(problem: Problem, trajectory: Trajectory) -> ChosenExecution:
    """Choose the rows that a controller is sent of a motion, as `choose_rows`."""
    execution, deadline = problem.execution, problem.deadline.at_least(CERTIFY_GRACE_S)
    assert execution is not None, "the problem has an execution"
    known = _CHOSEN.of(trajectory, execution)
    if known is not MISSING and known[1]() is problem.world:
        return known[0]
    _CHOSEN.forget(trajectory, execution)
    chosen = choose_rows(trajectory, execution, deadline, lambda motion: judge_drawn(problem, motion, deadline))
    _CHOSEN.keep(trajectory, execution, (chosen, weakref.ref(problem.world)))
    return chosen


def choose_rows(
    trajectory: Trajectory, execution: ControllerModel, deadline: Deadline, judge_motion: JudgeDrawn
) -> ChosenExecution:
    """Choose the rows that a controller is sent of a motion: more of them until what it draws is certified.

    Where the motion itself, within the tolerance, isn't certified, no more are tried; nor where a limit is exceeded
    that more of them don't keep better.
    """
    parts, refines, before = 1, execution.interpolation in (Interpolation.LINEAR, Interpolation.QUINTIC), np.inf
    while True:
        drawn = draw_plan(trajectory, execution, parts)
        chosen = ChosenExecution(drawn, *judge_motion(drawn.motion))
        if chosen.is_kept or not refines or parts >= MOST_PARTS or deadline.expired():
            return chosen
        if execution.count_rows(trajectory.times, 2 * parts) > MOST_SENT_ROWS:
            return chosen
        if chosen.stretch > 1.0 and chosen.stretch - 1.0 > REFINED * (before - 1.0):
            return chosen
        if parts == 1:
            verdict, stretch = judge_motion(SubmittedMotion.of(trajectory, execution.tube))
            if not verdict.free or stretch > 1.0:
                return chosen
        parts, before = 2 * parts, chosen.stretch if chosen.stretch > 1.0 else np.inf


def judge_drawn(conditions: Conditions, motion: SubmittedMotion, deadline: Deadline) -> tuple[Verdict, float]:
    """Judge what a controller draws: free, and as `judge_rates`."""
    return judge_rates(conditions, motion, certify_given(conditions, motion, deadline), deadline)


def judge_rates(
    conditions: Conditions, motion: SubmittedMotion, verdict: Verdict, deadline: Deadline
) -> tuple[Verdict, float]:
    """Judge whether a motion keeps path constraints and limits of rates, too; and `ChosenExecution.stretch`."""
    verdict = _with_constraints(conditions, verdict, motion.pieces, deadline, motion.tube)
    if not verdict.free:
        return verdict, 1.0
    group, uses = conditions.group, measure_limit_shares(motion, conditions.group, conditions.jerk_limits)
    stretch, refused = 1.0, list[Verdict]()
    if find_excess(conditions, motion) is not None:
        motion_limits: list[MotionLimit] = [*conditions.cartesian_limits]
        motion_limits += [] if conditions.effort_limit is None else [conditions.effort_limit]
        stretch = max(limit.stretch(motion.polynomials) for limit in motion_limits)
    rates = (
        (Reason.BEYOND_VELOCITY, uses.velocity, group.velocity_limits),
        (Reason.BEYOND_ACCELERATION, uses.acceleration, group.acceleration_limits),
        (Reason.BEYOND_JERK, uses.jerk, conditions.jerk_limits),
    )
    for order, (reason, use, limits) in enumerate(rates, 1):
        if use.is_within or use.coordinate is None or limits is None:
            continue
        stretch = max(stretch, np.inf if use.share is None else use.share ** (1.0 / order))
        joint, limit = group.joints[use.coordinate].name, float(limits[use.coordinate])
        fault = LimitFault(joint, np.inf if use.share is None else use.share * limit, -limit, limit)
        z = point_on(motion.pieces[use.piece], use.at)
        refused.append(Verdict(reason, verdict.evaluations, use.piece, use.at, (0, 0.0), None, z, fault))
    return refused[0] if refused else verdict, stretch


def certify_given(
    conditions: Conditions, motion: SubmittedMotion, deadline: Deadline, count: int | None = None
) -> Verdict:
    """Judge whether a motion, or its first pieces, is free, within the tube about it, and within joint limits."""
    pieces, world = motion.pieces[:count], conditions.world
    if len(pieces) == len(motion.pieces) and motion.velocities is not None and motion.tube is None:
        # it is measured by the very same pieces
        return certify_and_measure(motion.measured_among(conditions.scene), conditions, deadline)
    tube = None if motion.tube is None else motion.tube[:count]
    times = motion.scheduled.piece_times()[: len(pieces) + 1] if conditions.scene.moves else None
    verdict = certify(world, pieces, conditions.min_clearance, deadline=deadline, times=times, tube=tube)
    if motion.kind is not CurveKind.STEPS:
        return verdict
    beyond = judge_limits(world, motion.straight[:count])  # where a step is, and not in the middle of its box
    return verdict if beyond is None else first_refused(beyond, verdict)


Judge = Callable[[Problem, Trajectory], Verdict]  # judges a motion from time 0 on


def certify_motion(
    problem: Problem,
    trajectory: Trajectory,
    crossings: Mapping[int, int],
    stages: Stages,
    judged_by: Judge = judge,
    message: str = "on the exact geometry, between samples too",
) -> CertifiedMotion:
    """Return a trajectory with its judge's verdict; slower, where a controller draws it beyond a limit.

    Args:
        crossings: By index of each guide plane that was reached, the index of its knot.
    """
    with stages.enter("certify", message) as stage:
        verdict = judged_by(problem, trajectory)
        for attempt in range(MOST_SLOWED if problem.execution is not None and not problem.in_motion else 0):
            stretch = choose_execution(problem, trajectory).stretch
            if stretch <= 1.0 or not np.isfinite(stretch) or problem.deadline.expired():
                break
            problem.counters.collision_checks += verdict.evaluations
            trajectory = slow_down(trajectory, stretch, attempt)
            verdict = judged_by(problem, trajectory)
        problem.counters.collision_checks += verdict.evaluations
        stage.outcome = verdict.reason.value
    return CertifiedMotion(verdict, trajectory.positions, crossings, trajectory)


def slow_down(trajectory: Trajectory, stretch: float, attempt: int) -> Trajectory:
    """Stretch the time of a motion, by a little more with each attempt, since the rows are elsewhere then."""
    factor = stretch * (1.0 + 1e-9 * 10.0**attempt)
    begin = trajectory.times[0]
    times = begin + factor * (trajectory.times - begin)
    return Trajectory(times, trajectory.positions, cast(LocalRates, trajectory.velocities / factor))


def certify_as_far_as_found(problem: Problem, found: PathSoFar, stages: Stages) -> CertifiedMotion:
    """Return the motion of a stage that failed, certified as far as it goes."""
    with stages.enter("certify", "the motion as far as it got") as stage:
        pieces, times = found.bezier(), found.piece_times()
        deadline = problem.deadline.at_least(CERTIFY_GRACE_S)
        verdict = find_enclosed_start(problem, pieces[0, 0]) or certify(
            problem.world, pieces, problem.min_clearance, deadline=deadline, times=times
        )
        stage.outcome = verdict.reason.value
    return CertifiedMotion(verdict, found.path, found.crossings, failure=found.failure)


@memoized
def speeds_along(motion: Trajectory | SubmittedMotion, limits: tuple[CartesianLimit, ...]) -> tuple[CartesianUse, ...]:
    """The largest speeds and accelerations of bodies with limits along a motion."""
    return measure_cartesian(limits, motion.polynomials)


@memoized
def efforts_along(motion: Trajectory | SubmittedMotion, group: PlanningGroup, limit: EffortLimit) -> Efforts:
    """The torques along a motion, by the limits that bind it."""
    return measure_efforts(group, limit, motion.polynomials)


def find_excess(conditions: Conditions, motion: Trajectory | SubmittedMotion | None) -> Ending | None:
    """The refusal of a motion that exceeds a limit of speed in space or of torque; None where it doesn't."""
    if motion is None or not (conditions.cartesian_limits or conditions.effort_limit):
        return None
    for use in speeds_along(motion, conditions.cartesian_limits):
        if (excess := use.excess) is not None:
            message, details = use.describe_excess(f"{excess[2].time:.6g} s")
            return Ending(Status.INVALID_MOTION_PLAN, f"no motion within limits was found: {message}", details)
    limit = conditions.effort_limit
    beyond = None if limit is None else efforts_along(motion, conditions.group, limit).excess
    if beyond is None:
        return None
    message, details = beyond.describe_excess(f"{beyond.reached.time:.6g} s")
    return Ending(Status.INVALID_MOTION_PLAN, f"no motion within limits was found: {message}", details)


def certify_from_start(conditions: Conditions, motion: Trajectory, deadline: Deadline) -> Verdict:
    """Judge a motion from its start on, which need not be free, and the path constraints."""
    pieces, times = motion.bezier(), motion.piece_times()
    verdict = find_enclosed_start(conditions, pieces[0, 0], float(times[0])) or certify(
        conditions.world, pieces, conditions.min_clearance, deadline=deadline, times=times
    )
    return _with_constraints(conditions, verdict, pieces, deadline)


def _with_constraints(
    conditions: Conditions, verdict: Verdict, pieces: LocalCurves, deadline: Deadline, tube: np.ndarray | None = None
) -> Verdict:
    if not (verdict.free and conditions.path_constraints):
        return verdict
    kept = certify_constraints(conditions.constrained_frames, conditions.world.bodies.turns, pieces, deadline, tube)
    return replace(kept, evaluations=verdict.evaluations + kept.evaluations)


def find_enclosed_start(conditions: Conditions, z: LocalPoint, time: float = 0.0) -> Verdict | None:
    """The refusal of a motion with one body wholly inside another at its start (nv,); None if none is, or it touches.

    A certificate of what comes after the start doesn't see it: a mesh is a surface to Coal.
    """
    world = conditions.world_at(time)
    q = conditions.group.expand_from_local(z)
    inside = find_enclosed_pair(world, q)  # fast for most worlds, so it comes first
    if inside is None or world.in_collision(q):
        return None
    return Verdict(Reason.CONTACT, 1, 0, 0.0, (0, 0.0), inside, z)
