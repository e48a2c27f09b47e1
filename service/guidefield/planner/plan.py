"""The stages of a plan, in order: check the ends, cross guide planes, connect, relax, time, certify."""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from guidefield.collision.certify.certificate import certify
from guidefield.collision.certify.timed_certificate import certify_timed
from guidefield.collision.certify.verdict import Verdict
from guidefield.errors import Status
from guidefield.planner.ends import check_start, goal_points
from guidefield.planner.fallback_connection import PathSoFar, connect_to_goal, connect_to_plane
from guidefield.planner.finish import Finished, finish
from guidefield.planner.guide.guide import PROJECTED, cross
from guidefield.planner.guide.rounds import Attempt
from guidefield.planner.leaving import Left, after, joined, leave
from guidefield.planner.led_goal import led_goal_points
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.task.problem import Problem, TipGoal
from guidefield.planner.task.refusal import refusal
from guidefield.planner.task.stages import StageFailed, Stages
from guidefield.planner.task.trace import Note, StageLeft
from guidefield.planner.timed_guide import cross_planes_timed


class Planner(enum.Enum):
    """Which stages find the motion."""

    AUTO = "auto"
    GUIDED = "guided"
    TREE = "tree"


@dataclass(frozen=True, eq=False)
class Plan:
    """What came of planning; it cannot be made without a certificate's verdict.

    Attributes:
        status: How it ended.
        message: One sentence that a person can act on.
        verdict: The certificate's judgement of `trajectory`, or of `path` where there is no trajectory.
        path: What the planner found: chart points (n, nv), the best partial motion where it failed.
        trajectory: What the robot would execute; None where the planner failed.
        crossings: By index of each guide plane that was reached, its index in `path`.
        stages: What was done, in order.
        seconds: Time by stage.
        details: The values that the message speaks about.
        warnings: What was odd but harmless.
        judged_from: Since when the trajectory is judged: before that it leaves a contact at the start [s].
    """

    status: Status
    message: str
    verdict: Verdict
    path: np.ndarray
    trajectory: Trajectory | None = None
    crossings: dict[int, int] = field(default_factory=dict)
    stages: tuple[StageLeft, ...] = ()
    seconds: dict[str, float] = field(default_factory=dict)
    details: dict[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    judged_from: float = 0.0


def plan(problem: Problem, planner: Planner = Planner.AUTO, attempts: Sequence[Attempt] = PROJECTED) -> Plan:
    """Plan a motion.

    Args:
        problem: Robot, scene, start, goal, guide planes, budget.
        planner: Which stages find it.
        attempts: How each guide plane is tried.
    """
    if not problem.leave_start_contact:
        return _planned(problem, planner, attempts)
    stages = Stages(problem)
    try:
        left = leave(problem, stages)
    except StageFailed as failure:
        return _partial(problem, PathSoFar(problem.group.chart(problem.q_start)[None]), failure, stages)
    if left is None:
        return _planned(problem, planner, attempts)
    return _with_left(problem, left, _planned(after(problem, left), planner, attempts), stages)


def _with_left(problem: Problem, left: Left, rest: Plan, stages: Stages) -> Plan:
    """A plan from where a contact at the start was left, with the motion out of it before."""
    rest = dataclasses.replace(
        rest,
        stages=(*stages.left, *rest.stages),
        seconds={**rest.seconds, "ends": stages.seconds["ends"] + rest.seconds["ends"]},
        warnings=(left.warning, *rest.warnings),
    )
    if rest.trajectory is None:
        return rest
    trajectory, judged_from = joined(problem, left, rest.trajectory)
    path = np.concatenate([trajectory.positions[:1], rest.path])
    crossings = {plane: index + 1 for plane, index in rest.crossings.items()}
    return dataclasses.replace(rest, trajectory=trajectory, path=path, crossings=crossings, judged_from=judged_from)


def _planned(problem: Problem, planner: Planner, attempts: Sequence[Attempt]) -> Plan:
    stages = Stages(problem)
    found = PathSoFar(problem.group.chart(problem.q_start)[None])
    try:
        with stages.entered("ends", "start and goal") as stage:
            check_start(problem)
            goals, later = _goals_or_later(problem, planner)
            if later:
                stage.outcome = "the start is free; the goal's pose is looked for from where guide planes lead"
            elif goals is None:
                stage.outcome = "the start is free"
            else:
                stage.outcome = f"start free, free configurations at the goal: {len(goals)}"
        if problem.scene.moves:
            return _plan_in_time(problem, found, stages, attempts)
        if planner is not Planner.TREE:
            _cross_planes(problem, found, stages, planner, attempts)
        if later:
            goals = led_goal_points(problem, found, stages, attempts)
        if goals is not None:
            return _to_goal(problem, found, goals, stages)
    except StageFailed as failure:
        return _partial(problem, found, failure, stages)
    return _finished(problem, finish(problem, found.path, found.crossings, stages), stages)


def _goals_or_later(problem: Problem, planner: Planner) -> tuple[np.ndarray | None, bool]:
    """Chart points of the goal, None where a plane is the goal; and whether to look for them again behind the planes.

    Raises:
        StageFailed: as `goal_points`, where no guide planes lead to the goal.
    """
    try:
        return goal_points(problem), False
    except StageFailed as failure:
        leads = bool(problem.guide_planes) and planner is not Planner.TREE and not problem.scene.moves
        if not (leads and isinstance(problem.goal, TipGoal) and failure.status is Status.NO_IK_SOLUTION):
            raise
        return None, True


def _to_goal(problem: Problem, found: PathSoFar, goals: np.ndarray, stages: Stages) -> Plan:
    """Connect and finish: what is free at samples is relaxed at once; where that fails, it is proven before."""
    before = found.path
    with stages.entered("connect", "to the goal") as stage:
        proven = connect_to_goal(problem, found, goals, stage, prove=False)
    finished = finish(problem, found.path, found.crossings, stages, proven=proven)
    if not (proven or finished.verdict.free or problem.budget.spent()):
        problem.tell(Note("the relaxed motion was not certified: the connection is certified before it is relaxed"))
        found.path = before
        with stages.entered("connect", "to the goal, certified") as stage:
            connect_to_goal(problem, found, goals, stage)
        finished = finish(problem, found.path, found.crossings, stages)
    return _finished(problem, finished, stages)


def _plan_in_time(problem: Problem, found: PathSoFar, stages: Stages, attempts: Sequence[Attempt]) -> Plan:
    """Among obstacles that move: the guided planner in time, whose schedule is the trajectory's."""
    try:
        timed = cross_planes_timed(problem, stages, attempts)
    except StageFailed as failure:
        timed = failure.details.pop("path")
        found.path, found.crossings = np.array(timed.points), timed.crossings
        trajectory = timed.trajectory()
        with stages.entered("certify", "the motion as far as it got, in time") as stage:
            verdict = certify_timed(
                problem.timed_world, trajectory.bezier(), trajectory.piece_times(), problem.min_clearance
            )
            stage.outcome = verdict.reason.value
        return _failed(found, failure, verdict, stages)
    trajectory = timed.trajectory()
    with stages.entered("certify", "on the exact geometry, in time, between samples too") as stage:
        verdict = certify_timed(
            problem.timed_world, trajectory.bezier(), trajectory.piece_times(), problem.min_clearance
        )
        problem.counters.collision_checks += verdict.evaluations
        stage.outcome = verdict.reason.value
    finished = Finished(trajectory, verdict, np.array(timed.points), timed.crossings)
    return _finished(problem, finished, stages)


def refused(problem: Problem, status: Status, message: str, details: dict[str, Any]) -> Plan:
    """The plan of a problem that was not tried: nothing but the start, judged."""
    start = PathSoFar(problem.group.chart(problem.q_start)[None])
    return _partial(problem, start, StageFailed(status, message, **details), Stages(problem))


def _cross_planes(
    problem: Problem, found: PathSoFar, stages: Stages, planner: Planner, attempts: Sequence[Attempt]
) -> None:
    """The guided planner, plane by plane; where it gets stuck, `auto` goes on with a connection."""
    group = problem.group
    passed_by = False
    for index, plane in enumerate(problem.guide_planes):
        if passed_by and index < problem.derived_planes:
            continue
        with stages.entered("guide", f"to guide plane {plane.name}", index) as stage:
            crossing = cross(problem, group.from_chart(found.path[-1]), plane, index, attempts)
            stage.outcome = "reached" if crossing.status is Status.SUCCESS else crossing.status.name.lower()
        if crossing.status is Status.SUCCESS:
            found.extend(group.chart_path(list(crossing.path), found.path[-1]))
        elif planner is Planner.GUIDED or crossing.status in (Status.TIMED_OUT, Status.PREEMPTED):
            found.extend(group.chart_path(list(crossing.path), found.path[-1]))
            raise StageFailed(crossing.status, crossing.message, **crossing.details)
        elif index < problem.derived_planes:  # nobody asked for it: go on without it and those that would follow
            passed_by = True
            continue
        else:
            with stages.entered("connect", f"to guide plane {plane.name}, where the field got stuck", index) as stage:
                connect_to_plane(problem, found, crossing, index, stage)
        found.crossings[index] = len(found.path) - 1


def _partial(problem: Problem, found: PathSoFar, failure: StageFailed, stages: Stages) -> Plan:
    """The best motion so far, certified as far as it goes."""
    with stages.entered("certify", "the motion as far as it got") as stage:
        verdict = certify(problem.world, polyline(found.path), problem.min_clearance)
        stage.outcome = verdict.reason.value
    return _failed(found, failure, verdict, stages)


def _failed(found: PathSoFar, failure: StageFailed, verdict: Verdict, stages: Stages) -> Plan:
    return Plan(
        status=failure.status,
        message=failure.message,
        verdict=verdict,
        path=found.path,
        crossings=found.crossings,
        stages=tuple(stages.left),
        seconds=stages.seconds,
        details=failure.details,
    )


def _finished(problem: Problem, finished: Finished, stages: Stages) -> Plan:
    status, message = Status.SUCCESS, "found a motion and certified it free over its whole length"
    details: dict[str, Any] = {}
    verdict = finished.verdict
    if verdict.free and problem.budget.cancelled():
        status, message = Status.PREEMPTED, "cancelled; the motion by then is certified free over its whole length"
    if not verdict.free:
        status, message, details = refusal(problem, verdict)
    return Plan(
        status=status,
        message=message,
        verdict=verdict,
        path=finished.path,
        trajectory=finished.trajectory,
        crossings=finished.crossings,
        stages=tuple(stages.left),
        seconds=stages.seconds,
        details=details,
        warnings=finished.warnings,
    )


def polyline(path: np.ndarray) -> np.ndarray:
    """Straight pieces between chart points, shape (n, nv), as Bezier control points, shape (n - 1, 2, nv).

    A single point is one piece.
    """
    if len(path) == 1:
        return np.repeat(path[None], 2, axis=1)
    return np.stack([path[:-1], path[1:]], axis=1)
