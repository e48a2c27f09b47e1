"""The stages of a plan, in order: check the ends, cross guide planes, connect, optimise, certify."""

from __future__ import annotations

import enum
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, cast

import numpy as np

from guidefield.errors import Status
from guidefield.messages import scene as messages
from guidefield.planner.ends import UNREACHED, check_start, goal_points, tip_points
from guidefield.planner.fallback_connection import connect_to_goal, connect_to_plane
from guidefield.planner.finish import Finished, finish
from guidefield.planner.guide.guide import PROJECTED, cross
from guidefield.planner.guide.rounds import Attempt
from guidefield.planner.guide.tip_reach import tip_radius
from guidefield.planner.in_motion import STOPS, finish_in_motion, led_to, moving_ends
from guidefield.planner.judgement import finish_timed
from guidefield.planner.leaving import after, joined, leave
from guidefield.planner.motion.trajectory import Trajectory, one_after_another
from guidefield.planner.start_enclosure import enclosed_start
from guidefield.planner.task.ending import Ending, refusal
from guidefield.planner.task.problem import Problem, TipGoal
from guidefield.planner.task.stages import PathSoFar, StageFailed, Stages
from guidefield.planner.task.trace import Note, StageLeft
from guidefield.planner.timed_goal import reach_in_time
from guidefield.planner.timed_guide import cross_planes_timed
from guidefield.planner.timed_shape import shaped_across
from guidefield.prove.certificate import certify_timed
from guidefield.prove.verdict import Verdict
from guidefield.read_only import ReadOnly
from guidefield.robot.model.spaces import ChartPoint, ChartPoints
from guidefield.scene.flat import axes_across
from guidefield.scene.guide_plane import GuidePlane, build


class Planner(enum.Enum):
    """Which stages find the motion."""

    AUTO = "auto"
    GUIDED = "guided"
    TREE = "tree"


@dataclass(frozen=True, eq=False)
class Plan(ReadOnly):
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
    path: ChartPoints
    trajectory: Trajectory | None = None
    crossings: Mapping[int, int] = field(default_factory=dict)
    stages: tuple[StageLeft, ...] = ()
    seconds: dict[str, float] = field(default_factory=dict)
    details: dict[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    judged_from: float = 0.0


def plan(problem: Problem, planner: Planner = Planner.AUTO, attempts: Sequence[Attempt] = PROJECTED) -> Plan:
    """Plan a motion.

    Args:
        problem: Robot, scene, start, goal, guide planes, deadline.
        planner: Which stages find it.
        attempts: How each guide plane is tried.
    """
    stages = Stages(problem)
    return _told(problem, _out_of_contact(problem, planner, attempts, stages), stages)


def refused(problem: Problem, status: Status, message: str, details: dict[str, Any]) -> Plan:
    """The plan of a problem that was not tried: nothing but the start, judged."""
    stages = Stages(problem)
    return _told(problem, _not_begun(problem, Ending(status, message, details), stages), stages)


def _out_of_contact(problem: Problem, planner: Planner, attempts: Sequence[Attempt], stages: Stages) -> Finished:
    """A contact at the start is left first, if that is asked for; the rest is planned from there."""
    if not problem.leave_start_contact:
        return _from_start(problem, planner, attempts, stages)
    try:
        left = leave(problem, stages)
    except StageFailed as failed:
        return _not_begun(problem, failed.ending, stages)
    if left is None:
        return _from_start(problem, planner, attempts, stages)
    return joined(problem, left, _from_start(after(problem, left), planner, attempts, stages))


def _from_start(problem: Problem, planner: Planner, attempts: Sequence[Attempt], stages: Stages) -> Finished:
    """The stages in order: each goes on from the path of those before; what the last one leaves is finished."""
    try:
        goals = _ends(problem, planner, stages)
    except StageFailed as failed:
        return _not_begun(problem, failed.ending, stages)
    if problem.in_motion:
        assert goals is not None, "planes are no goals then"
        return _in_motion(problem, goals, stages)
    if problem.scene.moves:
        return _in_time(problem, goals, stages, attempts)
    found = PathSoFar.at_start(problem)
    if planner is not Planner.TREE:
        found = _cross_planes(problem, found, stages, planner, attempts)
    if goals is None and isinstance(problem.goal, TipGoal) and found.failure is None:
        found, goals = led_goal_points(problem, found, stages, attempts)
    if goals is None or found.failure is not None:
        return finish(problem, found, stages)
    return _to_goal(problem, found, goals, stages)


def _in_motion(problem: Problem, goals: ChartPoints, stages: Stages) -> Finished:
    """From a start in motion, or to an end in motion; among obstacles that move the robot stops first."""
    try:
        ends = moving_ends(problem, goals, stages)
    except StageFailed as failed:
        return _not_begun(problem, failed.ending, stages)
    if not problem.scene.moves:
        return finish_in_motion(problem, ends, stages)

    def go_on(then: Problem) -> Finished:
        return _go_on(then, ends.inner_goals, stages)

    stopped = gone_on(problem, ends.stop, go_on, ends.around, stages, {})
    return replace(stopped, warnings=(*stopped.warnings, STOPS))


def _in_time(problem: Problem, goals: ChartPoints | None, stages: Stages, attempts: Sequence[Attempt]) -> Finished:
    """Among obstacles that move: through guide planes, and from the last of them to a goal if there is one."""
    if not problem.guide_planes:
        assert goals is not None, "without planes there is a goal"
        return reach_in_time(problem, goals, stages)
    crossed = cross_planes_timed(problem, stages, attempts)
    if crossed.failure is not None:
        return finish_timed(problem, crossed, stages)
    shaped = shaped_across(problem, crossed, stages)
    if goals is None:
        return shaped or finish_timed(problem, crossed, stages)
    begun, crossings = crossed.trajectory(), crossed.knots
    if shaped is not None and shaped.trajectory is not None:
        begun, crossings = shaped.trajectory, shaped.crossings

    def go_on(then: Problem) -> Finished:
        return _go_on(then, goals, stages)

    def around(rest: Trajectory) -> Trajectory:
        return one_after_another([led_to(begun, rest), rest])

    return gone_on(problem, begun, go_on, around, stages, crossings)


def _go_on(problem: Problem, goals: ChartPoints, stages: Stages) -> Finished:
    """To a goal from where the robot is by now: among what still moves, or what has come to rest."""
    if problem.scene.moves:
        return reach_in_time(problem, goals, stages)
    return _to_goal(problem, PathSoFar.at_start(problem), goals, stages)


def _ends(problem: Problem, planner: Planner, stages: Stages) -> ChartPoints | None:
    """Chart points of the goal; None where a plane is the goal, or its pose is to be looked for behind the planes.

    Raises:
        StageFailed: as `check_start`; as `goal_points`, where no guide planes lead to the goal.
    """
    with stages.entered("ends", "start and goal") as stage:
        check_start(problem.at(0.0))
        try:
            goals = goal_points(problem.at(problem.scene.end))
        except StageFailed as failed:
            if problem.scene.moves:
                raise _once_all_rest(problem, failed) from None
            leads = bool(problem.guide_planes) and planner is not Planner.TREE and not problem.scene.moves
            unreached = failed.ending.status in UNREACHED
            if not (leads and unreached and isinstance(problem.goal, TipGoal)):
                raise
            stage.outcome = "the start is free; the goal's pose is looked for from where guide planes lead"
            return None
        if goals is None:
            stage.outcome = "the start is free"
        else:
            stage.outcome = f"start free, free configurations at the goal: {len(goals)}"
    return goals


def _once_all_rest(problem: Problem, failed: StageFailed) -> StageFailed:
    """Why a goal is none among obstacles that move: it is judged as they stand once they have come to rest."""
    end, ending = problem.scene.end, failed.ending
    message = f"as the obstacles stand from {end:.2f} s on: {ending.message}"
    return StageFailed(ending.status, message, **{**ending.details, "time": end})


def _cross_planes(
    problem: Problem, found: PathSoFar, stages: Stages, planner: Planner, attempts: Sequence[Attempt]
) -> PathSoFar:
    """The guided planner, plane by plane; where it gets stuck, `auto` goes on with a connection."""
    group = problem.group
    passed_by = False
    for index, plane in enumerate(problem.guide_planes):
        if passed_by and index < problem.derived_planes:
            continue
        with stages.entered("guide", f"to guide plane {plane.name}", index) as stage:
            crossing = cross(problem, group.from_chart(found.path[-1]), plane, index, attempts)
            stage.outcome = (
                "reached" if crossing.status is Status.SUCCESS else crossing.status.name.lower().replace("_", " ")
            )
            along = found.extended(group.chart_path(list(crossing.path), found.path[-1]))
        if crossing.status is Status.SUCCESS:
            found = along
        elif planner is Planner.GUIDED or crossing.status in (Status.TIMED_OUT, Status.PREEMPTED):
            return along.failed(Ending(crossing.status, crossing.message, crossing.details))
        elif index < problem.derived_planes:  # nobody asked for it: go on without it and those that would follow
            passed_by = True
            continue
        else:
            with stages.entered("connect", f"to guide plane {plane.name}, where the field got stuck", index) as stage:
                found = connect_to_plane(problem, found, crossing, index, stage)
            if found.failure is not None:
                return found
        found = found.on_plane(index)
    return found


def _to_goal(problem: Problem, found: PathSoFar, goals: ChartPoints, stages: Stages) -> Finished:
    """Connect and finish: what is free at samples is optimised at once; where that fails, it is proven before."""
    with stages.entered("connect", "to the goal") as stage:
        connected = connect_to_goal(problem, found, goals, stage, prove=False)
    finished = finish(problem, connected, stages)
    settled = connected.proven or finished.failure is not None or finished.verdict.free
    if settled or problem.deadline.expired():
        return finished
    problem.tell(Note("the motion was not certified: the connection is certified before it is made one again"))
    with stages.entered("connect", "to the goal, certified") as stage:
        connected = connect_to_goal(problem, found, goals, stage)
    return finish(problem, connected, stages)


def _not_begun(problem: Problem, failure: Ending, stages: Stages) -> Finished:
    """Nothing but the start."""
    return finish(problem, PathSoFar.at_start(problem).failed(failure), stages)


def _told(problem: Problem, finished: Finished, stages: Stages) -> Plan:
    """The plan: how it ended, with what."""
    ended = finished.failure or _judgement(problem, finished.verdict)
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
    )


def _judgement(problem: Problem, verdict: Verdict) -> Ending:
    """How a plan ended that has a trajectory, by the verdict about that."""
    if not verdict.free:
        return refusal(problem, verdict)
    if problem.deadline.is_cancelled():
        message = "cancelled; the motion by then is certified free over its whole length"
        return Ending(Status.PREEMPTED, message)
    return Ending(Status.SUCCESS, "found a motion and certified it free over its whole length")


def gone_on(
    problem: Problem,
    begun: Trajectory,
    go_on: Callable[[Problem], Finished],
    around: Callable[[Trajectory], Trajectory],
    stages: Stages,
    crossings: Mapping[int, int],
) -> Finished:
    """The motion that has begun and what follows it, judged in time as one.

    Args:
        problem: Robot, obstacles and what to keep.
        begun: The motion so far, from time 0 on, in the end at rest.
        go_on: Plans what follows, from where the motion ends; time 0 is then.
        around: Makes the whole of what follows.
        stages: Where time is counted.
        crossings: By index of each guide plane that was reached by then, the index of its knot.

    Returns:
        The whole; where what follows failed, the motion so far, judged, and why.
    """
    end = float(begun.times[-1])
    rest = go_on(problem.since(end, problem.group.from_chart(begun.positions[-1])))
    whole = begun if rest.trajectory is None else around(rest.trajectory)
    with stages.entered("certify", "the whole motion, in time, between samples too") as stage:
        pieces, times = whole.bezier(), whole.piece_times()
        verdict = enclosed_start(problem, pieces[0, 0]) or certify_timed(
            problem.world, pieces, times, problem.min_clearance, deadline=problem.deadline
        )
        problem.counters.collision_checks += verdict.evaluations
        stage.outcome = verdict.reason.value
    if rest.trajectory is None:
        return Finished(verdict, begun.positions, crossings, failure=rest.failure, warnings=rest.warnings)
    path = np.concatenate([whole.positions[: len(begun.positions)], rest.path[1:]])
    return Finished(verdict, path, crossings, whole, warnings=rest.warnings)


ROOM = 1.05
"""Half side of the square about the goal over the radius of the tip's body."""


def led_goal_points(
    problem: Problem, found: PathSoFar, stages: Stages, attempts: Sequence[Attempt]
) -> tuple[PathSoFar, ChartPoints]:
    """Chart points that reach the goal's pose, looked for from where the guided planner gets to it.

    The guided planner goes on to a small square about the goal's place, across the way there: among obstacles, the
    configuration it arrives at is one that fits there, and the pose is looked for next to it.

    Args:
        problem: Robot, world and a `TipGoal`.
        found: The motion so far, through all guide planes.
        stages: Gets a stage for it.
        attempts: How the square is tried.

    Returns:
        The motion so far with the way to the goal's place, and chart points (m, nv); none of them where it failed, with
        one of `UNREACHED` and the reason, TIMED_OUT or PREEMPTED.
    """
    assert isinstance(problem.goal, TipGoal)
    group, target = problem.group, problem.goal.target
    with stages.entered("guide", "to the place of the goal's pose") as stage:
        here = found.path[-1]
        square = _square(problem, here, np.asarray(target.placement.translation))
        crossing = cross(problem, group.from_chart(here), square, len(problem.guide_planes), attempts)
        stage.outcome = (
            "reached" if crossing.status is Status.SUCCESS else crossing.status.name.lower().replace("_", " ")
        )
    along = group.chart_path(list(crossing.path), here)
    if crossing.status is Status.SUCCESS:
        found = found.extended(along)
    try:
        return found, tip_points(problem, target, (along[-1], here))
    except StageFailed as failed:
        return found.failed(failed.ending), cast(ChartPoints, np.empty((0, group.nv)))


def _square(problem: Problem, here: ChartPoint, place: np.ndarray) -> GuidePlane:
    """As small as the tip's body lets it be, about a place (3,), across the straight way of the tip there."""
    way = place - problem.kinematics.tip_position(problem.group.expand_from_chart(here))
    length = float(np.linalg.norm(way))
    across = axes_across(way / length if length > 1e-9 else np.array([0.0, 0.0, 1.0]))
    half = ROOM * max(tip_radius(problem), 1e-3)
    corners = np.array([(-half, -half), (half, -half), (half, half), (-half, half)])
    vertices = [tuple(vertex) for vertex in (place + corners @ across).tolist()]
    return build(messages.GuidePlane(name="goal", vertices=vertices), 0)
