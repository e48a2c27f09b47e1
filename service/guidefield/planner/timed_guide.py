"""The guided planner among obstacles that move: over configuration and time.

Each round of advance, slide and reorient is made among the obstacles as they stand a little ahead of the robot's time;
it takes as long as its motions from rest to rest take within the limits, and is kept if the certificate of timed
motions says that it is free of what moves meanwhile. Otherwise the robot waits, or gives way, and tries again.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from guidefield.errors import Status
from guidefield.planner.guide.aim import ANYWHERE, Aim
from guidefield.planner.guide.guide import margin_at
from guidefield.planner.guide.guided_path import GuidedPath
from guidefield.planner.guide.rounds import Attempt, Round, approach
from guidefield.planner.guide.settings import APPROACH
from guidefield.planner.guide.tip_reach import inset_of, unreachable_at_once
from guidefield.planner.motion.rest_to_rest import CUBIC, Profile, profile_of
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.optimize.worth import keeps_aside
from guidefield.planner.path_motion import limits_of
from guidefield.planner.task.ending import Ending, stopped_before
from guidefield.planner.task.problem import Problem
from guidefield.planner.task.stages import Stages
from guidefield.planner.task.trace import Note, Step, StepKind
from guidefield.prove.certificate import certify_moving
from guidefield.prove.verdict import Verdict
from guidefield.read_only import ReadOnly
from guidefield.robot.model.margin import MARGIN
from guidefield.robot.model.spaces import ChartPoint

NOMINAL = 0.9
"""Share of the velocity limits that is used; its square of the accelerations', its cube of the jerks'."""
AHEAD = 0.25
"""How far ahead of the robot's time the obstacles' places are looked at first [s]."""
WAIT = 0.1
"""How long the robot waits before it looks again [s]."""
COMFORT = 0.02
"""What a round keeps from what moves, beyond what is asked for, if it does after waiting for `PATIENCE` at most [m]."""
PATIENCE = 1.0
"""For how long the robot waits for that [s]: what moves on leaves more room. Else the round keeps `MARGIN`."""


@dataclass(frozen=True, eq=False)
class TimedPath(ReadOnly):
    """Chart points and when the robot is there, at rest; and why it goes no further where a plane was not reached.

    Attributes:
        points: Each of shape (nv,) [rad or m].
        times: Increasing [s].
        crossings: By index of each guide plane that was reached, its index in the path.
        failure: Why the next plane was not reached; None while all were.
        profile: How it goes from one point to the next.
    """

    points: tuple[ChartPoint, ...]
    times: tuple[float, ...] = (0.0,)
    crossings: Mapping[int, int] = field(default_factory=dict)
    failure: Ending | None = None
    profile: Profile = CUBIC

    @property
    def time(self) -> float:
        """When it ends [s]."""
        return self.times[-1]

    @property
    def waited(self) -> float:
        """For how long the robot has stood where it was [s]."""
        stood = (a is b for a, b in pairwise(self.points))
        return sum(end - begin for (begin, end), still in zip(pairwise(self.times), stood, strict=True) if still)

    def extended(self, points: Sequence[ChartPoint], times: Sequence[float]) -> TimedPath:
        """Gone on to more chart points, each of shape (nv,), where the robot is at some times [s]."""
        return dataclasses.replace(self, points=(*self.points, *points), times=(*self.times, *times))

    def on_plane(self, index: int) -> TimedPath:
        """The same, with the guide plane of an index reached where it ends."""
        return dataclasses.replace(self, crossings={**self.crossings, index: len(self.points) - 1})

    def failed(self, failure: Ending) -> TimedPath:
        """The same, as far as it goes."""
        return dataclasses.replace(self, failure=failure)

    def trajectory(self, since: int = 0) -> Trajectory:
        """The motion from the point of an index on: from rest to rest between one point and the next."""
        return self.profile.through(np.array(self.points[since:]), np.array(self.times[since:]))

    @property
    def knots(self) -> Mapping[int, int]:
        """By index of each guide plane that was reached, the knot of `trajectory` that is on it."""
        return {plane: at * self.profile.pieces for plane, at in self.crossings.items()}


def cross_planes_timed(problem: Problem, stages: Stages, attempts: Sequence[Attempt]) -> TimedPath:
    """Bring the tip onto the guide planes, one after the other, among obstacles that move.

    Returns:
        The motion through all planes; failed before the first one where `cross` gives up and waiting doesn't help.
    """
    path = TimedPath((problem.z_start,), profile=profile_of(limits_of(problem)))
    for index, plane in enumerate(problem.guide_planes):
        aim = Aim(plane, inset_of(problem, plane))
        with stages.entered("guide", f"to guide plane {plane.name}, in time", index) as stage:
            before = path.waited
            path = _to_plane(problem, path, aim, index, attempts)
            if path.failure is not None:
                stage.outcome = path.failure.message
                return path
            stage.outcome = f"reached at {path.time:.2f} s, {path.waited - before:.1f} s of it waiting"
        path = path.on_plane(index)
    return path


def _to_plane(problem: Problem, path: TimedPath, aim: Aim, index: int, attempts: Sequence[Attempt]) -> TimedPath:
    """The path onto a guide plane, or failed before it."""
    impossible = unreachable_at_once(problem.at(problem.scene.end), aim.plane)
    if impossible is not None:
        reason, details = impossible
        message = f"guide plane {aim.plane.name!r}: {reason}"
        return path.failed(Ending(Status.GUIDE_PLANE_UNREACHABLE, message, details))
    problem.tell(
        Step(StepKind.START, problem.group.from_chart(path.points[-1]), f"towards {aim.plane.name}", None, index)
    )
    while True:
        if (status := problem.deadline.status()) is not None:
            message = stopped_before(status, aim.plane.name, aim.distance(_tip(problem, path)))
            return _given_up(status, message, problem, path, aim, index)
        path, ended = _round(problem, path, aim, index, attempts)
        if ended is Round.ARRIVED:
            return path
        if ended is Round.BLOCKED:
            path = _waiting(problem, path, aim, index, attempts[0])
            if path.failure is not None:
                return path
            problem.tell(Note(f"waits at {path.time:.2f} s"))


def _round(
    problem: Problem, path: TimedPath, aim: Aim, index: int, attempts: Sequence[Attempt]
) -> tuple[TimedPath, Round]:
    """The first round that is free of what moves, among the obstacles as they stand ahead of time, then as now.

    While something moves, a round that is refused in time is waited for and not made in another way. Where an advance
    is blocked, another attempt of the same minimizer asks for the same one, or shorter ones that were tried.
    """
    for seen in _seen(problem, path, (AHEAD, 0.0)):
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
            if (longer := _in_comfort(problem, path, guided) or _along(problem, path, guided)) is not None:
                return longer, ended
            if path.time < problem.scene.end:
                break
    return path, Round.BLOCKED


def _waiting(problem: Problem, path: TimedPath, aim: Aim, index: int, attempt: Attempt) -> TimedPath:
    """The path with the robot waiting at its end, or giving way; failed where neither helps."""
    if path.time > problem.scene.end:
        distance = aim.distance(_tip(problem, path))
        message = (
            f"stuck {1000 * distance:.0f} mm before guide plane {aim.plane.name!r} after {path.time:.1f} s, when"
            " all obstacles had come to rest"
        )
        return _given_up(Status.STUCK_IN_MINIMUM, message, problem, path, aim, index)
    waiting = path.extended([path.points[-1]], [path.time + WAIT])
    verdict = _judged(problem, waiting.trajectory(since=-2), MARGIN)
    if verdict.free:
        return waiting
    if (gave_way := _giving_way(problem, path, index, attempt)) is not None:
        return gave_way
    names = " and ".join(verdict.pair or ("a link", "an obstacle"))
    message = (
        f"stuck before guide plane {aim.plane.name!r}: at {path.time:.2f} s {names} would meet, and the robot"
        " found no way to give way"
    )
    pair = list(verdict.pair) if verdict.pair else None
    return _given_up(Status.STUCK_IN_MINIMUM, message, problem, path, aim, index, pair=pair)


def _giving_way(problem: Problem, path: TimedPath, index: int, attempt: Attempt) -> TimedPath | None:
    """The path out of the way, if there is one: a descent among the obstacles as they will stand, tip in its plane."""
    for seen in _seen(problem, path, (2.0 * WAIT, WAIT, 0.0)):
        guided = seen.guided(path, index)
        for normal in np.eye(3):
            since = guided.q
            attempt.minimizer.settle(guided, guided.tip, normal, ANYWHERE)
            if guided.q is not since and (longer := _along(problem, path, guided)) is not None:
                return longer
    return None


@dataclass(frozen=True, eq=False)
class _Seen(ReadOnly):
    """The obstacles held where they are at some time, and what steps keep from them there [m]."""

    problem: Problem
    margin: float

    def guided(self, path: TimedPath, index: int) -> GuidedPath:
        """A guided path from where a path ends, on the way to the guide plane of an index."""
        return GuidedPath(self.problem, self.problem.group.from_chart(path.points[-1]), self.margin, index)


def _seen(problem: Problem, path: TimedPath, ahead: Sequence[float]) -> Iterator[_Seen]:
    """The obstacles at each look ahead [s]; one look only once all rest."""
    q = problem.group.from_chart(path.points[-1])
    for more in ahead if path.time < problem.scene.end else (0.0,):
        held = problem.at(path.time + more)
        yield _Seen(held, margin_at(held, q))


def _in_comfort(problem: Problem, path: TimedPath, guided: GuidedPath) -> TimedPath | None:
    """The path with a guided path's way after it, once that keeps `COMFORT`; None if it doesn't within `PATIENCE`."""
    before = path
    while path.time < problem.scene.end and path.time <= before.time + PATIENCE:
        if (longer := _along(problem, path, guided, COMFORT)) is not None:
            return longer
        waiting = path.extended([path.points[-1]], [path.time + WAIT])
        if not _judged(problem, waiting.trajectory(since=-2), MARGIN).free:
            return None
        path = waiting
        problem.tell(Note(f"waits at {path.time:.2f} s"))
    return None


def _along(problem: Problem, path: TimedPath, guided: GuidedPath, margin: float = MARGIN) -> TimedPath | None:
    """The path with a guided path's way after it, if that keeps a margin [m] from what moves."""
    points = problem.group.chart_path(guided.path, path.points[-1])[1:]
    times, before = [], path.points[-1]
    time, limits = path.time, limits_of(problem)
    for point in points:
        time += path.profile.duration(before, point, limits, NOMINAL)
        times.append(time)
        before = point
    longer = path.extended(list(points), times)
    way = longer.trajectory(since=len(path.points) - 1)
    if not keeps_aside(problem, way, problem.min_clearance + margin):
        return None  # a certificate takes longer to refuse it
    return longer if _judged(problem, way, margin).free else None


def _judged(problem: Problem, way: Trajectory, margin: float) -> Verdict:
    """Return whether a way keeps a margin [m] from what moves, beyond what is asked for."""
    verdict = certify_moving(problem.world, way.bezier(), way.piece_times(), problem.min_clearance + margin)
    problem.counters.collision_checks += verdict.evaluations
    return verdict


def _tip(problem: Problem, path: TimedPath) -> np.ndarray:
    return problem.kinematics.tip_position(problem.group.expand_from_chart(path.points[-1]))


def _given_up(
    status: Status, message: str, problem: Problem, path: TimedPath, aim: Aim, index: int, **more: object
) -> TimedPath:
    """The path, failed before a guide plane."""
    details = {
        **more,
        "stage": "guide",
        "plane": index,
        "guide_plane": aim.plane.name,
        "distance": max(aim.distance(_tip(problem, path)) - APPROACH.on_plane, 0.0),
        "time": path.time,
    }
    return path.failed(Ending(status, message, details))
