"""The guided planner among obstacles that move: over configuration and time.

Each round of advance, slide and reorient is made among the obstacles as they stand a little ahead of the robot's time;
it takes as long as its motions from rest to rest take within the limits, and is kept if the certificate of timed
motions says that it is free of what moves meanwhile. Otherwise the robot waits, or gives way, and tries again.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from guidefield.errors import Status
from guidefield.planner.guide.aim import ANYWHERE, Aim
from guidefield.planner.guide.guide import margin_at
from guidefield.planner.guide.guided_path import GuidedPath
from guidefield.planner.guide.rounds import Attempt, Round, approach
from guidefield.planner.guide.settings import APPROACH
from guidefield.planner.guide.tip_reach import inset_of, unreachable_at_once
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.optimize.worth import keeps_aside
from guidefield.planner.path_motion import limits_of
from guidefield.planner.path_so_far import ScheduledPath
from guidefield.planner.task.ending import Ending, stopped_before
from guidefield.planner.task.problem import Problem
from guidefield.planner.task.trace import Note, Step, StepKind
from guidefield.prove.certificate import certify_moving
from guidefield.prove.verdict import Verdict
from guidefield.read_only import ReadOnly
from guidefield.robot.model.size import MARGIN
from guidefield.scene.guide_plane import GuidePlane

NOMINAL = 0.9
"""Share of the velocity limits that is used; its square of the accelerations', its cube of the jerks'."""
AHEAD = 0.25
"""How far ahead of the robot's time the obstacles' places are looked at first [s]."""
WAIT = 0.1
"""How long the robot waits before it looks again [s]."""
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
        """A guided path from where a path ends, on the way to the guide plane of an index."""
        return GuidedPath(self.problem, self.problem.group.from_chart(path.z), self.margin, index)


def _look_ahead(problem: Problem, path: ScheduledPath, ahead: Sequence[float]) -> Iterator[_Seen]:
    """The obstacles at each look ahead [s]; one look only once all rest."""
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
    """The path with a guided path's way after it, if that keeps a margin [m] from what moves."""
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
    """Return whether a way keeps a margin [m] from what moves, beyond what is asked for."""
    verdict = certify_moving(problem.world, way.bezier(), way.piece_times(), problem.min_clearance + margin)
    problem.counters.collision_checks += verdict.evaluations
    return verdict


def _tip(problem: Problem, path: ScheduledPath) -> np.ndarray:
    return problem.kinematics.tip_position(problem.group.expand_from_chart(path.z))


def _give_up(
    status: Status, message: str, problem: Problem, path: ScheduledPath, aim: Aim, index: int, **more: object
) -> ScheduledPath:
    """The path, failed before a guide plane."""
    details = {
        **more,
        "stage": "guide",
        "plane": index,
        "guide_plane": aim.plane.name,
        "distance": max(aim.distance(_tip(problem, path)) - APPROACH.on_plane * problem.group.size, 0.0),
        "time": path.time,
    }
    return path.failed(Ending(status, message, details))
