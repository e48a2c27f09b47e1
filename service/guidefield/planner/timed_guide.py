"""The guided planner among obstacles that move: over configuration and time.

Each round of advance, slide and reorient is made among the obstacles as they stand a little ahead of the robot's time;
it takes as long as its motions from rest to rest take within the limits, and is kept if the certificate of timed
motions says that it is free of what moves meanwhile. Otherwise the robot waits, or gives way, and tries again.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from guidefield.collision.certify.timed_certificate import certify_moving
from guidefield.collision.certify.verdict import Verdict
from guidefield.errors import Status
from guidefield.planner.guide.aim import ANYWHERE, Aim
from guidefield.planner.guide.guide import margin_at
from guidefield.planner.guide.guided_path import GuidedPath
from guidefield.planner.guide.rounds import ON_PLANE, Attempt, Round, approach
from guidefield.planner.guide.tip_reach import inset_of, unreachable_at_once
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.task.problem import Problem
from guidefield.planner.task.refusal import stopped_before
from guidefield.planner.task.stages import StageFailed, Stages
from guidefield.planner.task.trace import Note, Step

NOMINAL = 0.9
"""Share of the velocity limits, and of the square root of the acceleration limits, that motions are timed with."""
AHEAD = 0.25
"""How far ahead of the robot's time the obstacles' places are looked at first [s]."""
WAIT = 0.1
"""How long the robot waits before it looks again [s]."""
MARGIN = 2e-3
"""Distance from obstacles that move beyond what is asked for [m]."""


@dataclass
class TimedPath:
    """Chart points and when the robot is there, at rest.

    Attributes:
        points: Each of shape (nv,) [rad or m].
        times: Increasing [s].
        crossings: By index of each guide plane that was reached, its index in the path.
    """

    points: list[np.ndarray]
    times: list[float] = field(default_factory=lambda: [0.0])
    crossings: dict[int, int] = field(default_factory=dict)

    @property
    def time(self) -> float:
        """When it ends [s]."""
        return self.times[-1]

    def trajectory(self) -> Trajectory:
        """The motion: from rest to rest between one point and the next."""
        positions = np.array(self.points)
        return Trajectory(np.array(self.times), positions, np.zeros_like(positions))


def cross_planes_timed(problem: Problem, stages: Stages, attempts: Sequence[Attempt]) -> TimedPath:
    """Bring the tip onto the guide planes, one after the other, among obstacles that move.

    Raises:
        StageFailed: as `cross` gives up, where waiting does not help either; `details` hold the path so far.
    """
    path = TimedPath([problem.group.chart(problem.q_start)])
    for index, plane in enumerate(problem.guide_planes):
        aim = Aim(plane, inset_of(problem, plane))
        with stages.entered("guide", f"to guide plane {plane.name}, in time", index) as stage:
            impossible = unreachable_at_once(problem.at(problem.scene.end), plane)
            if impossible is not None:
                message = f"guide plane {plane.name!r}: {impossible[0]}"
                raise StageFailed(Status.GUIDE_PLANE_UNREACHABLE, message, path=path, **impossible[1])
            problem.tell(Step("start", problem.group.from_chart(path.points[-1]), f"towards {plane.name}", None, index))
            waited = _cross(problem, path, aim, index, attempts)
            stage.outcome = f"reached at {path.time:.2f} s, {waited:.1f} s of it waiting"
        path.crossings[index] = len(path.points) - 1
    return path


def _cross(problem: Problem, path: TimedPath, aim: Aim, index: int, attempts: Sequence[Attempt]) -> float:
    """Rounds, or waiting, until the tip is on the plane; how long it waited [s]."""
    waited = 0.0
    while True:
        if (spent := problem.budget.spent()) is not None:
            message = stopped_before(spent, aim.plane.name, aim.distance(_tip(problem, path)))
            raise StageFailed(spent, message, **_details(problem, path, aim, index))
        ended = _round(problem, path, aim, index, attempts)
        if ended is Round.ARRIVED:
            return waited
        if ended is Round.NEARER:
            continue
        if path.time > problem.scene.end:
            distance = aim.distance(_tip(problem, path))
            raise StageFailed(
                Status.STUCK_IN_MINIMUM,
                f"stuck {1000 * distance:.0f} mm before guide plane {aim.plane.name!r} after {path.time:.1f} s, when"
                " all obstacles had come to rest",
                **_details(problem, path, aim, index),
            )
        refused = _extended(problem, path, [path.points[-1]], [path.time + WAIT])
        if refused is not None and not _gave_way(problem, path, index, attempts[0]):
            names = " and ".join(refused.pair or ("a link", "an obstacle"))
            raise StageFailed(
                Status.STUCK_IN_MINIMUM,
                f"stuck before guide plane {aim.plane.name!r}: at {path.time:.2f} s {names} would meet, and the robot"
                " found no way to give way",
                pair=list(refused.pair) if refused.pair else None,
                **_details(problem, path, aim, index),
            )
        waited += WAIT
        problem.tell(Note(f"waits at {path.time:.2f} s"))


def _round(problem: Problem, path: TimedPath, aim: Aim, index: int, attempts: Sequence[Attempt]) -> Round:
    """The first round that is free of what moves, among the obstacles as they stand ahead of time, then as now."""
    for attempt in attempts:
        for guided in _walkers(problem, path, (AHEAD, 0.0), index):
            ended = approach(guided, aim, attempt)
            if ended is Round.BLOCKED:
                continue
            if _kept(problem, path, guided) is None:
                return ended
    return Round.BLOCKED


def _gave_way(problem: Problem, path: TimedPath, index: int, attempt: Attempt) -> bool:
    """Whether the robot got out of the way: it descends among the obstacles as they will stand, tip in its plane."""
    for guided in _walkers(problem, path, (2.0 * WAIT, WAIT, 0.0), index):
        for normal in np.eye(3):
            since = guided.q
            attempt.minimizer.settle(guided, guided.tip, normal, ANYWHERE)
            if guided.q is not since and _kept(problem, path, guided) is None:
                return True
    return False


def _walkers(problem: Problem, path: TimedPath, ahead: Sequence[float], index: int) -> Iterator[GuidedPath]:
    """A guided path at the end of the path for each look ahead [s]; one look only once all obstacles rest."""
    q = problem.group.from_chart(path.points[-1])
    for more in ahead if path.time < problem.scene.end else (0.0,):
        seen = problem.at(path.time + more)
        yield GuidedPath(seen, q, margin_at(seen, q), index)


def _kept(problem: Problem, path: TimedPath, guided: GuidedPath) -> Verdict | None:
    """Add a guided path's way to the path, if what moves lets it; else why not."""
    points = problem.group.chart_path(guided.path, path.points[-1])[1:]
    times, before = [], path.points[-1]
    time = path.time
    for point in points:
        time += duration(problem, before, point)
        times.append(time)
        before = point
    problem.robot_field.evaluations += guided.problem.robot_field.evaluations
    return _extended(problem, path, list(points), times)


def _extended(problem: Problem, path: TimedPath, points: list[np.ndarray], times: list[float]) -> Verdict | None:
    """Add points to the path if the motion through them is free of what moves; else why not."""
    through = [path.points[-1], *points]
    pieces = np.array([[a, b] for a, b in pairwise(through)])
    margin = problem.min_clearance + MARGIN
    rest = np.array([_from_rest_to_rest(*piece) for piece in pieces])
    verdict = certify_moving(problem.timed_world, rest, np.array([path.time, *times]), margin)
    problem.counters.collision_checks += verdict.evaluations
    if not verdict.free:
        return verdict
    path.points += points
    path.times += times
    return None


def _from_rest_to_rest(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Bezier control points of the cubic that begins and ends at rest."""
    return np.array([start, start, end, end])


def duration(problem: Problem, start: np.ndarray, end: np.ndarray) -> float:
    """How long the cubic from rest to rest takes within the limits [s]: 3/2 d/T is its velocity, 6 d/T^2 its ends'.

    Args:
        problem: Whose limits.
        start: Chart point, shape (nv,) [rad or m].
        end: Chart point, shape (nv,).
    """
    way = np.abs(end - start)
    group = problem.group
    by_velocity = 1.5 * way / (NOMINAL * group.velocity_limits)
    by_acceleration = np.sqrt(6.0 * way / group.acceleration_limits) / NOMINAL
    return max(float(by_velocity.max()), float(by_acceleration.max()), 1e-3)


def _tip(problem: Problem, path: TimedPath) -> np.ndarray:
    return problem.kinematics.tip_position(problem.group.from_chart(path.points[-1]))


def _details(problem: Problem, path: TimedPath, aim: Aim, index: int) -> dict[str, object]:
    distance = max(aim.distance(_tip(problem, path)) - ON_PLANE, 0.0)
    return {
        "stage": "guide",
        "plane": index,
        "guide_plane": aim.plane.name,
        "distance": distance,
        "time": path.time,
        "path": path,
    }
