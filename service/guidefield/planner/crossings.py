"""Cross guide planes, one after the other, by the guided planner; where it gets stuck, `auto` goes on by a connection.

Among obstacles that move its steps keep a schedule, and nothing is connected: the robot waits, or gives way.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from guidefield.errors import Status
from guidefield.messages import scene as messages
from guidefield.planner.ends import tip_points
from guidefield.planner.guide.guide import cross, margin_at
from guidefield.planner.guide.guided_path import GuidedPath
from guidefield.planner.guide.rounds import ANYWHERE, Aim, Attempt, Round, approach
from guidefield.planner.guide.settings import APPROACH
from guidefield.planner.guide.tip_reach import inset_of, tip_radius, unreachable_at_once
from guidefield.planner.held_paths import connect_to_plane
from guidefield.planner.motion.profiles import profile_of
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.optimize.clearance_samples import keeps_aside
from guidefield.planner.path_so_far import PathSoFar, ScheduledPath, limits_of
from guidefield.planner.task.problem import Problem, TipGoal
from guidefield.planner.task.stages import Ending, Stage, StageFailed, Stages, stopped_before
from guidefield.planner.task.trace import Note, Step, StepKind
from guidefield.prove.certificate import certify_moving
from guidefield.prove.verdict import Verdict
from guidefield.read_only import ReadOnly
from guidefield.robot.model.size import MARGIN
from guidefield.robot.model.spaces import ChartPoint, ChartPoints
from guidefield.scene.flat import axes_across
from guidefield.scene.guide_plane import GuidePlane, build

NOMINAL = 0.9  # share of the velocity limits that is used; its square of the accelerations', its cube of the jerks'
AHEAD = 0.25  # how far ahead of the robot's time the obstacles' places are looked at first [s]
WAIT = 0.1  # how long the robot waits before it looks again [s]
COMFORT = 0.02
"""What a round keeps from what moves, beyond what is asked for, if it does after waiting for `PATIENCE` at most [m],
at size 1."""
PATIENCE = 1.0
"""For how long the robot waits for that [s]: what moves on leaves more room. Else the round keeps `MARGIN`."""


def approach_in_time(
    problem: Problem, path: ScheduledPath, plane: GuidePlane, index: int, attempts: Sequence[Attempt]
) -> ScheduledPath:
    """Bring the tip onto a guide plane among obstacles that move.

    Returns:
        The motion onto the plane; failed before it where `cross` gives up and waiting doesn't help.
    """
    aim = Aim(plane, inset_of(problem, plane))
    impossible = unreachable_at_once(problem.at(problem.scene.end), aim.plane)
    if impossible is not None:
        reason, details = impossible
        message = f"guide plane {aim.plane.name!r}: {reason}"
        return path.failed(Ending(Status.GUIDE_PLANE_UNREACHABLE, message, details))
    problem.tell(Step(StepKind.START, problem.group.from_chart(path.z), f"towards {aim.plane.name}", None, index))
    while True:
        if (status := problem.deadline.status()) is not None:
            message = stopped_before(status, aim.plane.name, aim.distance(_tip(problem, path)))
            return _give_up(status, message, problem, path, aim, index)
        path, ended = _make_round(problem, path, aim, index, attempts)
        if ended is Round.ARRIVED:
            return path
        if ended is Round.BLOCKED:
            path = _wait(problem, path, aim, index, attempts[0])
            if path.failure is not None:
                return path
            problem.tell(Note(f"waits at {path.time:.2f} s"))


def _make_round(
    problem: Problem, path: ScheduledPath, aim: Aim, index: int, attempts: Sequence[Attempt]
) -> tuple[ScheduledPath, Round]:
    """The first round that is free of what moves, among the obstacles as they stand ahead of time, then as now.

    While something moves, a round that is refused in time is waited for and not made in another way. Where an advance
    is blocked, another attempt of the same minimizer asks for the same one, or shorter ones that were tried.
    """
    for seen in _look_ahead(problem, path, (AHEAD, 0.0)):
        blocked: set[type] = set()
        for attempt in attempts:
            if type(attempt.minimizer) in blocked:
                continue
            guided = seen.guided(path, index)
            counted = seen.problem.robot_field.evaluations
            ended = approach(guided, aim, attempt)
            problem.robot_field.evaluations += seen.problem.robot_field.evaluations - counted
            if ended is Round.BLOCKED:
                blocked.add(type(attempt.minimizer))
                continue
            if (longer := _extend_in_comfort(problem, path, guided) or _extend(problem, path, guided)) is not None:
                return longer, ended
            if path.time < problem.scene.end:
                break
    return path, Round.BLOCKED


def _wait(problem: Problem, path: ScheduledPath, aim: Aim, index: int, attempt: Attempt) -> ScheduledPath:
    """The path with the robot waiting at its end, or giving way; failed where neither helps."""
    if path.time > problem.scene.end:
        distance = aim.distance(_tip(problem, path))
        message = (
            f"stuck {1000 * distance:.0f} mm before guide plane {aim.plane.name!r} after {path.time:.1f} s, when"
            " all obstacles had come to rest"
        )
        return _give_up(Status.STUCK_IN_MINIMUM, message, problem, path, aim, index)
    waiting = path.until([path.z], [path.time + WAIT])
    verdict = _judge(problem, waiting.trajectory(since=-2), MARGIN * problem.group.size)
    if verdict.free:
        return waiting
    if (gave_way := _give_way(problem, path, index, attempt)) is not None:
        return gave_way
    names = " and ".join(verdict.pair or ("a link", "an obstacle"))
    message = (
        f"stuck before guide plane {aim.plane.name!r}: at {path.time:.2f} s {names} would meet, and the robot"
        " found no way to give way"
    )
    pair = list(verdict.pair) if verdict.pair else None
    return _give_up(Status.STUCK_IN_MINIMUM, message, problem, path, aim, index, pair=pair)


def _give_way(problem: Problem, path: ScheduledPath, index: int, attempt: Attempt) -> ScheduledPath | None:
    """The path out of the way, if there is one: a descent among the obstacles as they will stand, tip in its plane."""
    for seen in _look_ahead(problem, path, (2.0 * WAIT, WAIT, 0.0)):
        guided = seen.guided(path, index)
        for normal in np.eye(3):
            since = guided.q
            attempt.minimizer.settle(guided, guided.tip, normal, ANYWHERE)
            if guided.q is not since and (longer := _extend(problem, path, guided)) is not None:
                return longer
    return None


@dataclass(frozen=True, eq=False)
class _Seen(ReadOnly):
    """The obstacles held where they are at some time, and what steps keep from them there [m]."""

    problem: Problem
    margin: float

    def guided(self, path: ScheduledPath, index: int) -> GuidedPath:
        return GuidedPath(self.problem, self.problem.group.from_chart(path.z), self.margin, index)


def _look_ahead(problem: Problem, path: ScheduledPath, ahead: Sequence[float]) -> Iterator[_Seen]:
    q = problem.group.from_chart(path.z)
    for more in ahead if path.time < problem.scene.end else (0.0,):
        held = problem.at(path.time + more)
        yield _Seen(held, margin_at(held, q))


def _extend_in_comfort(problem: Problem, path: ScheduledPath, guided: GuidedPath) -> ScheduledPath | None:
    """The path with a guided path's way after it, once that keeps `COMFORT`; None if it doesn't within `PATIENCE`."""
    before = path
    while path.time < problem.scene.end and path.time <= before.time + PATIENCE:
        if (longer := _extend(problem, path, guided, COMFORT * problem.group.size)) is not None:
            return longer
        waiting = path.until([path.z], [path.time + WAIT])
        if not _judge(problem, waiting.trajectory(since=-2), MARGIN * problem.group.size).free:
            return None
        path = waiting
        problem.tell(Note(f"waits at {path.time:.2f} s"))
    return None


def _extend(problem: Problem, path: ScheduledPath, guided: GuidedPath, margin: float = MARGIN) -> ScheduledPath | None:
    points = problem.group.chart_path(guided.path, path.z)[1:]
    times, before = [], path.z
    time, limits = path.time, limits_of(problem)
    for point in points:
        time += path.profile.duration(before, point, limits, NOMINAL)
        times.append(time)
        before = point
    longer = path.until(list(points), times)
    way = longer.trajectory(since=len(path.path) - 1)
    if not keeps_aside(problem, way, problem.min_clearance + margin):
        return None  # a certificate takes longer to refuse it
    return longer if _judge(problem, way, margin).free else None


def _judge(problem: Problem, way: Trajectory, margin: float) -> Verdict:
    verdict = certify_moving(problem.world, way.bezier(), way.piece_times(), problem.min_clearance + margin)
    problem.counters.collision_checks += verdict.evaluations
    return verdict


def _tip(problem: Problem, path: ScheduledPath) -> np.ndarray:
    return problem.kinematics.tip_position(problem.group.expand_from_chart(path.z))


def _give_up(
    status: Status, message: str, problem: Problem, path: ScheduledPath, aim: Aim, index: int, **more: object
) -> ScheduledPath:
    details = {
        **more,
        "stage": "guide",
        "plane": index,
        "guide_plane": aim.plane.name,
        "distance": max(aim.distance(_tip(problem, path)) - APPROACH.on_plane * problem.group.size, 0.0),
        "time": path.time,
    }
    return path.failed(Ending(status, message, details))


def cross_planes(problem: Problem, stages: Stages, attempts: Sequence[Attempt], *, connects: bool) -> PathSoFar:
    """Bring the tip onto the guide planes of a problem, in order.

    A derived one may be passed by, with those that follow it. It fails before a plane that isn't reached; among
    obstacles that rest a connection may go on where the field gets stuck.
    """
    found: PathSoFar = PathSoFar.at_start(problem)
    if problem.scene.moves:
        found = ScheduledPath(found.path, profile=profile_of(limits_of(problem)))
    passed_by = False
    for index, plane in enumerate(problem.guide_planes):
        if passed_by and index < problem.derived_planes:
            continue
        if problem.path_constraints:  # which the field's steps would leave
            with stages.entered("connect", f"to guide plane {plane.name}", index) as stage:
                along = connect_to_plane(problem, found, found, index, stage)
        else:
            with stages.entered("guide", f"to guide plane {plane.name}", index) as stage:
                along = _approach(problem, found, plane, index, attempts, stage)
        failure = along.failure
        if failure is None:
            found = along
        elif not connects or failure.status in (Status.TIMED_OUT, Status.PREEMPTED):
            return along
        elif index < problem.derived_planes:  # nobody asked for it: go on without it and those that would follow
            passed_by = True
            continue
        elif problem.scene.moves or problem.path_constraints:
            return along
        else:
            with stages.entered("connect", f"to guide plane {plane.name}, where the field got stuck", index) as stage:
                found = connect_to_plane(problem, found, along, index, stage)
            if found.failure is not None:
                return found
        found = found.on_plane(index)
    return found


def _approach(
    problem: Problem, found: PathSoFar, plane: GuidePlane, index: int, attempts: Sequence[Attempt], stage: Stage
) -> PathSoFar:
    if isinstance(found, ScheduledPath):
        along = approach_in_time(problem, found, plane, index, attempts)
        waited = along.waited - found.waited
        stage.outcome = f"reached at {along.time:.2f} s, {waited:.1f} s of it waiting"
        if along.failure is not None:
            stage.outcome = along.failure.message
        return along
    crossing = cross(problem, problem.group.from_chart(found.path[-1]), plane, index, attempts)
    reached = crossing.status is Status.SUCCESS
    stage.outcome = "reached" if reached else crossing.status.name.lower().replace("_", " ")
    along_planes = found.extended(problem.group.chart_path(list(crossing.path), found.path[-1]))
    return along_planes if reached else along_planes.failed(Ending(crossing.status, crossing.message, crossing.details))


SQUARE = 1.05  # half side of the square about the goal over the radius of the tip's body


def find_led_goals(
    problem: Problem, found: PathSoFar, stages: Stages, attempts: Sequence[Attempt]
) -> tuple[PathSoFar, ChartPoints]:
    """Chart points (m, nv) that reach the goal's pose, looked for from where the guided planner gets, and the motion.

    The guided planner goes on to a small square about the goal's place, across the way there: among obstacles, the
    configuration it arrives at is one that fits there, and the pose is looked for next to it. There are none where it
    failed, with one of `UNREACHED` and the reason, TIMED_OUT or PREEMPTED.
    """
    assert isinstance(problem.goal, TipGoal)
    group, target = problem.group, problem.goal.target
    with stages.entered("guide", "to the place of the goal's pose") as stage:
        here = found.path[-1]
        square = _square(problem, here, np.asarray(target.placement.translation))
        along = _approach(problem, found, square, len(problem.guide_planes), attempts, stage)
    found = found if along.failure is not None else along
    try:
        return found, tip_points(problem, target, (along.path[-1], here))
    except StageFailed as failed:
        return found.failed(failed.ending), cast(ChartPoints, np.empty((0, group.nv)))


def _square(problem: Problem, here: ChartPoint, place: np.ndarray) -> GuidePlane:
    """As small as the tip's body lets it be, about a place (3,), across the straight way of the tip there."""
    way = place - problem.kinematics.tip_position(problem.group.expand_from_chart(here))
    length = float(np.linalg.norm(way))
    across = axes_across(way / length if length > 1e-9 else np.array([0.0, 0.0, 1.0]))
    half = SQUARE * max(tip_radius(problem), 1e-3)
    corners = np.array([(-half, -half), (half, -half), (half, half), (-half, half)])
    vertices = [tuple(vertex) for vertex in (place + corners @ across).tolist()]
    return build(messages.GuidePlane(name="goal", vertices=vertices), 0)
