"""Plan a motion, stage by stage: check the ends, cross guide planes, connect, optimise, certify.

Guide planes are crossed by the guided planner; where it gets stuck, `auto` goes on by a connection. A `Plan` always has
a verdict: one that failed has that of its path as far as it got. `Planner` and stages' names are words of the wire.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, cast

import numpy as np

from guidefield.errors import Status
from guidefield.messages import scene as messages
from guidefield.planner.ends import UNREACHED, check_start, find_goal_points, find_tip_points
from guidefield.planner.finish import STOPS, MovingEnds, finish, moving_ends
from guidefield.planner.goal_among_movers import reach_among_movers
from guidefield.planner.guide.guide import PROJECTED, cross_plane, tip_radius
from guidefield.planner.guide.rounds import Attempt
from guidefield.planner.held_paths import Through, connect_to_plane, connections
from guidefield.planner.leaving import continue_after, join_way_out, judge_leaving, leave_contacts
from guidefield.planner.motion.drawn_motion import DrawnMotion
from guidefield.planner.motion.submitted_motion import SubmittedMotion
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.motion_certificate import (
    CERTIFY_GRACE_S,
    MOST_SLOWED,
    CertifiedMotion,
    certify_given,
    certify_motion,
    choose_execution,
    choose_rows,
    find_excess,
    judge_rates,
    slow_down,
)
from guidefield.planner.path_so_far import PathSoFar
from guidefield.planner.task.problem import ControllerModel, Problem, TipGoal
from guidefield.planner.task.stages import Ending, Stage, StageFailed, Stages, make_ending_at_rest, make_refusal
from guidefield.planner.task.trace import StageLeft
from guidefield.prove.verdict import Verdict
from guidefield.read_only import ReadOnly
from guidefield.robot.model.joints import LocalPoint, LocalPoints
from guidefield.scene.guide_plane import GuidePlane, axes_across, build


def cross_planes(
    problem: Problem, found: PathSoFar, stages: Stages, attempts: Sequence[Attempt], *, connects: bool
) -> PathSoFar:
    """Bring the tip onto the guide planes of a problem, in order, from where a motion ends.

    A derived one may be passed by, with those that follow it. It fails before a plane that isn't reached; a connection
    may go on where the field gets stuck.
    """
    passed_by = False
    for index, plane in enumerate(problem.guide_planes):
        if passed_by and index < problem.derived_planes:
            continue
        if problem.path_constraints:  # which the field's steps would leave
            with stages.enter("connect", f"to guide plane {plane.name}", index) as stage:
                along = connect_to_plane(problem, found, found, index, stage)
        else:
            with stages.enter("guide", f"to guide plane {plane.name}", index) as stage:
                along = _approach(problem, found, plane, index, attempts, stage)
        failure = along.failure
        if failure is None:
            found = along
        elif not connects or failure.status in (Status.TIMED_OUT, Status.PREEMPTED):
            return along
        elif index < problem.derived_planes:  # no request names it: go on without it and those that would follow
            passed_by = True
            continue
        elif problem.path_constraints:
            return along
        else:
            with stages.enter("connect", f"to guide plane {plane.name}, where the field got stuck", index) as stage:
                found = connect_to_plane(problem, found, along, index, stage)
            if found.failure is not None:
                return found
        found = found.with_plane_reached(index)
    return found


def _approach(
    problem: Problem, found: PathSoFar, plane: GuidePlane, index: int, attempts: Sequence[Attempt], stage: Stage
) -> PathSoFar:
    crossing = cross_plane(problem, problem.group.from_local(found.path[-1]), plane, index, attempts)
    reached = crossing.status is Status.SUCCESS
    stage.outcome = "reached" if reached else crossing.status.name.lower().replace("_", " ")
    along_planes = found.extend(problem.group.local_path(list(crossing.path), found.path[-1]))
    return (
        along_planes
        if reached
        else along_planes.with_failure(Ending(crossing.status, crossing.message, crossing.details))
    )


SQUARE = 1.05  # half side of the square about the goal, over the radius of the tip's body; below 1 that wouldn't fit


def find_goals_behind_planes(
    problem: Problem, found: PathSoFar, stages: Stages, attempts: Sequence[Attempt]
) -> tuple[PathSoFar, LocalPoints]:
    """Points (m, nv) that reach the goal's pose, searched for from where the guided planner gets, and the motion.

    The guided planner goes on to a small square about the goal's place, across the path there: among obstacles, the
    configuration it arrives at is one that fits there, and the pose is searched for next to it. There are none where it
    failed, with one of `ends.UNREACHED` and the reason, TIMED_OUT or PREEMPTED.
    """
    assert isinstance(problem.goal, TipGoal)
    group, target = problem.group, problem.goal.target
    with stages.enter("guide", "to the place of the goal's pose") as stage:
        here = found.path[-1]
        square = _make_square(problem, here, np.asarray(target.placement.translation))
        along = _approach(problem, found, square, len(problem.guide_planes), attempts, stage)
    found = found if along.failure is not None else along
    try:
        return found, find_tip_points(problem, target, (along.path[-1], here))
    except StageFailed as failed:
        return found.with_failure(failed.ending), cast(LocalPoints, np.empty((0, group.nv)))


def _make_square(problem: Problem, here: LocalPoint, place: np.ndarray) -> GuidePlane:
    """A square as small as the tip's body allows, about a place (3,), across the straight path of the tip there."""
    offset = place - problem.kinematics.tip_position(problem.group.expand_from_local(here))
    length = float(np.linalg.norm(offset))
    across = axes_across(offset / length if length > 1e-9 else np.array([0.0, 0.0, 1.0]))
    half = SQUARE * max(tip_radius(problem.group), 1e-3)
    corners = np.array([(-half, -half), (half, -half), (half, half), (-half, half)])
    vertices = [tuple(vertex) for vertex in (place + corners @ across).tolist()]
    return build(messages.GuidePlane(name="goal", vertices=vertices), 0)


class Planner(enum.Enum):
    """The stages that find the motion; the values are those of requests."""

    AUTO = "auto"
    GUIDED = "guided"
    TREE = "tree"


@dataclass(frozen=True, eq=False)
class Plan(ReadOnly):
    """The result of planning; it cannot be made without a certificate's verdict."""

    status: Status
    message: str
    verdict: Verdict  # the certificate's judgement of `trajectory`, or of `path` where there is no trajectory
    path: LocalPoints  # what the planner found: local coordinates (n, nv), the best partial motion where it failed
    trajectory: Trajectory | None = None  # what the robot would execute; None where the planner failed
    # by index of each guide plane that was reached, its index in `path`
    crossings: Mapping[int, int] = field(default_factory=dict)
    stages: tuple[StageLeft, ...] = ()
    seconds: dict[str, float] = field(default_factory=dict)
    details: dict[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    judged_from: float = 0.0  # since when the certificate holds: before that a contact at the start is left [s]
    drawn: DrawnMotion | None = None  # what a controller is sent of it; None without an execution


def plan(problem: Problem, planner: Planner = Planner.AUTO, attempts: Sequence[Attempt] = PROJECTED) -> Plan:
    """Plan a motion."""
    stages, left = Stages(problem), None
    try:
        left = leave_contacts(problem, stages) if problem.leave_start_contact else None
    except StageFailed as failed:
        return _make_plan(problem, _refuse_start(problem, failed.ending, stages), stages)
    finished = _plan_from_start(continue_after(problem, left) if left else problem, planner, attempts, stages)
    if left is None:
        return _make_plan(problem, finished, stages)
    whole, drawn = join_way_out(left, finished), None
    if problem.execution is not None and whole.trajectory is not None and whole.verdict.free:
        whole, drawn = _choose_leaving(problem, problem.execution, whole, whole.trajectory)
    return _make_plan(problem, whole, stages, drawn)


def _choose_leaving(
    problem: Problem, execution: ControllerModel, whole: CertifiedMotion, trajectory: Trajectory
) -> tuple[CertifiedMotion, DrawnMotion]:
    """Choose the rows of a motion that leaves a contact at its start, slower where it has to be."""
    deadline, left_at = problem.deadline.at_least(CERTIFY_GRACE_S), whole.judged_from

    def judge_motion(motion: SubmittedMotion) -> tuple[Verdict, float]:
        nonlocal left_at
        leaving = judge_leaving(problem, motion)
        verdict = certify_given(problem, motion, deadline) if leaving is None else leaving.verdict
        left_at = 0.0 if leaving is None else cast(float, motion.along(leaving.piece, leaving.share)[1])
        return judge_rates(problem, motion, verdict, deadline)

    for attempt in range(MOST_SLOWED):
        chosen = choose_rows(trajectory, execution, deadline, judge_motion)
        if chosen.stretch <= 1.0 or not np.isfinite(chosen.stretch) or problem.in_motion or deadline.expired():
            break
        trajectory = slow_down(trajectory, chosen.stretch, attempt)
    return replace(whole, verdict=chosen.verdict, trajectory=trajectory, judged_from=left_at), chosen.drawn


def make_refused_plan(problem: Problem, status: Status, message: str, details: dict[str, Any]) -> Plan:
    """Make the plan of a problem that was not tried: nothing but the start and its verdict."""
    stages = Stages(problem)
    return _make_plan(problem, _refuse_start(problem, Ending(status, message, details), stages), stages)


def _plan_from_start(
    problem: Problem, planner: Planner, attempts: Sequence[Attempt], stages: Stages
) -> CertifiedMotion:
    try:
        goals = _find_ends(problem, planner, stages)
    except StageFailed as failed:
        return _refuse_start(problem, failed.ending, stages)
    if problem.in_motion:
        assert goals is not None, "planes are no goals then"
        return _plan_in_motion(problem, goals, stages)
    through = _cross_planes(problem, goals, planner, attempts, stages)
    if problem.scene.moves:
        return reach_among_movers(problem, goals, through, stages)
    found, goals = through(problem, PathSoFar.at_start(problem), True)
    if goals is None or found.failure is not None:
        return finish(problem, found, stages)
    return _reach_goal(problem, found, goals, stages)


def _cross_planes(
    problem: Problem, goals: LocalPoints | None, planner: Planner, attempts: Sequence[Attempt], stages: Stages
) -> Through:
    """The path through a problem's guide planes, among its obstacles or some of them, to the goals after them."""

    def through(among: Problem, found: PathSoFar, thoroughly: bool) -> tuple[PathSoFar, LocalPoints | None]:
        behind, tried = goals, attempts if thoroughly else attempts[:1]
        if planner is not Planner.TREE and among.guide_planes:
            connects = thoroughly and planner is Planner.AUTO
            found = cross_planes(among, found, stages, tried, connects=connects)
        if goals is None and isinstance(among.goal, TipGoal) and found.failure is None:
            found, behind = find_goals_behind_planes(among, found, stages, tried)
        if among.robot_field is not problem.robot_field:
            problem.robot_field.evaluations += among.robot_field.evaluations
            among.robot_field.evaluations = 0
        return found, behind

    return through


def _plan_in_motion(problem: Problem, goals: LocalPoints, stages: Stages) -> CertifiedMotion:
    """From a start in motion, or to an end in motion; among obstacles that move the robot stops first."""
    try:
        ends = moving_ends(problem, goals, stages)
    except StageFailed as failed:
        return _refuse_start(problem, failed.ending, stages)
    stop, then = ends.stop, ends.between(problem)
    if not problem.scene.moves:
        return _reach_goal(problem, PathSoFar.at_start(then), ends.inner_goals, stages, ends)
    through = _cross_planes(then, ends.inner_goals, Planner.TREE, (), stages)
    rest = reach_among_movers(then, ends.inner_goals, through, stages)
    whole = stop if rest.trajectory is None else ends.around(rest.trajectory)
    certified = certify_motion(problem, whole, {}, stages, message="the whole motion, between samples too")
    if rest.trajectory is None:
        return replace(certified, trajectory=None, failure=rest.failure, warnings=(*rest.warnings, STOPS))
    path = np.concatenate([whole.positions[: len(stop.positions)], rest.path[1:]])
    return replace(certified, path=path, warnings=(*rest.warnings, STOPS))


def _find_ends(problem: Problem, planner: Planner, stages: Stages) -> LocalPoints | None:
    """Local coordinates of the goal; None where a plane is the goal, or its pose is searched for behind the planes."""
    with stages.enter("ends", "start and goal") as stage:
        check_start(problem.at(0.0))
        try:
            goals = find_goal_points(problem.at(problem.scene.end))
        except StageFailed as failed:
            leads = bool(problem.guide_planes) and planner is not Planner.TREE and not problem.path_constraints
            unreached = failed.ending.status in UNREACHED
            if not (leads and unreached and isinstance(problem.goal, TipGoal)):
                ending = make_ending_at_rest(problem, failed.ending)
                raise StageFailed(ending.status, ending.message, **ending.details) from None
            stage.outcome = "the start is free; the goal's pose is searched for from where guide planes lead"
            return None
        if goals is None:
            stage.outcome = "the start is free"
        else:
            stage.outcome = f"start free, free configurations at the goal: {len(goals)}"
    return goals


def _reach_goal(
    problem: Problem, found: PathSoFar, goals: LocalPoints, stages: Stages, ends: MovingEnds | None = None
) -> CertifiedMotion:
    """Connect and finish: a path free at samples is optimised at once; if that fails, one is certified before."""
    finished, among, words = None, problem, "to the goal"
    if ends is not None:
        among, words = ends.between(problem), "from where it can stop to where it gets up to speed"
    for connected in connections(among, found, goals, stages, words):
        finished = finish(problem, connected, stages, ends)
        if finished.verdict.free:
            break
    assert finished is not None, "the first connection is tried, whatever the time"
    return finished


def _refuse_start(problem: Problem, failure: Ending, stages: Stages) -> CertifiedMotion:
    return finish(problem, PathSoFar.at_start(problem).with_failure(failure), stages)


def _make_plan(problem: Problem, finished: CertifiedMotion, stages: Stages, drawn: DrawnMotion | None = None) -> Plan:
    trajectory = finished.trajectory
    if drawn is None and trajectory is not None and problem.execution is not None:
        drawn = choose_execution(problem, trajectory).drawn
    if finished.failure is not None:
        ended = finished.failure
    elif not finished.verdict.free:
        ended = make_refusal(problem, finished.verdict)
    elif (excess := find_excess(problem, trajectory if drawn is None else drawn.motion)) is not None:
        ended = excess
    elif problem.deadline.is_cancelled():
        ended = Ending(Status.PREEMPTED, "cancelled; the motion by then is certified free over its whole length")
    else:
        ended = Ending(Status.SUCCESS, "found a motion and certified it free over its whole length")
    return Plan(
        status=ended.status,
        message=ended.message,
        verdict=finished.verdict,
        path=finished.path,
        trajectory=finished.trajectory,
        crossings=finished.crossings,
        stages=tuple(stages.left),
        seconds=stages.seconds,
        details=ended.details,
        warnings=finished.warnings,
        judged_from=finished.judged_from,
        drawn=drawn,
    )
