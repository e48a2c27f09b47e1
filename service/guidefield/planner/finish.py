"""Make the certified trajectory of a path that was found, also of one whose motion begins or ends in motion.

What the certificate refuses is optimised again with more weight on the clearance, and more samples, and with samples
where it touches. Where that can't be certified either, a motion between it and the path that was found is taken, or
that path, as fast as it can be executed round its corners. Where that is refused the motion is drawn closer to it. In
the end it stops at every corner: then it is the path itself.

From velocities at the start, or into some at the goal, the path is planned from rest to rest (`MovingEnds`), so there
is always a motion: stop, go, and get up to speed. The optimiser makes one of it that doesn't stop. If a joint can't
come to rest before its limit or an obstacle, the plan is refused. Among obstacles that move the certificate of the
stop is time-dependent; that of the run to the goal is for obstacles at rest.

Every motion that is returned has the certificate's verdict, whatever the numbers here; they change which motion it is,
if one is free, and the time. `LOST`, `OVERLOADED`, `STOPPING` and `STOPS` are warnings of replies; `_START` and `_GOAL`
name fields of the wire.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, cast

import numpy as np

from guidefield.collision.clearance import clearance_at
from guidefield.errors import Status
from guidefield.planner.motion.limit_load import TOLERANCE
from guidefield.planner.motion.timing import remove_repetitions
from guidefield.planner.motion.trajectory import (
    Trajectory,
    choose_jerks,
    concatenate,
    reverse_motion,
    separate_jerks,
    stop_motion,
    unwrap_towards,
)
from guidefield.planner.motion_certificate import CertifiedMotion, certify_as_far_as_found, certify_motion, judge_itself
from guidefield.planner.optimized_motion import CrossedPlanes, bring_onto_planes, is_overloaded, optimize_motion
from guidefield.planner.path_so_far import (
    PathSoFar,
    limits_of,
    round_path,
    time_path,
    time_path_ignoring_jerk,
    time_path_with_stops,
)
from guidefield.planner.task.effort import torques_of
from guidefield.planner.task.motion_limits import KEPT_SHARE
from guidefield.planner.task.problem import Problem
from guidefield.planner.task.stages import StageFailed, Stages
from guidefield.planner.tree_search import RESOLUTION
from guidefield.prove.verdict import LIMIT_TOLERANCE, Reason
from guidefield.read_only import ReadOnly
from guidefield.robot.model.joints import LocalPoint, LocalPoints, LocalRate, LocalRates

REPAIRS = 4
"""How often a motion round corners is drawn closer to the path, to half its distance each time, where it is refused."""

STRAIGHT_MARGIN = 0.03
"""Distance that straight paths which take the place of steps between guide planes keep from obstacles, beyond the
required clearance [m], at size 1. A choice: less than what the optimiser keeps, so that it has to push little."""

BLENDS = (0.9, 0.75, 0.5, 0.25)  # shares tried of the way from the motion as found to a refused one. A choice
BLEND_PLACES = 65  # places of which a motion between these two is made. A choice

LOST = "the optimised motion did not cross every guide plane within its polygon"
"""Warning about a motion that is the one that was found therefore."""

OVERLOADED = "the optimised motion exceeded limits of torques or speeds; this is the motion as it was found"
"""Warning about a motion that is slower therefore."""

STOPPING = "no motion round the corners of the path was certified: this one stops at each of them"
"""Warning about a motion that is slower therefore."""

STOPS = "no motion within limits was found that doesn't stop: this one comes to rest after its start, or before its end"
"""Warning about a motion that begins or ends in motion, and is at rest on the way."""


def finish(problem: Problem, found: PathSoFar, stages: Stages, ends: MovingEnds | None = None) -> CertifiedMotion:
    """Make a certified trajectory of a path whose straight pieces are free; judge one that failed as far as it goes.

    Only one that is proven itself is worth a try where the optimised one is refused. With `ends` the path is between
    them, and the trajectory has them before and after it.
    """
    moves = ends is not None or len(remove_repetitions(found.path)) > 1
    if found.failure is not None or problem.optimization_iterations == 0 or not moves:
        return certify_found_path(problem, found, stages, ends)
    finished = _optimize_path(problem, found, stages, ends)
    if finished is not None and finished.verdict.free:
        return _keep_limits(problem, finished, found, stages, ends)
    if finished is not None and not found.proven:
        return finished
    as_found = certify_found_path(problem, found, stages, ends)
    if finished is None:
        return as_found if ends is not None else _add_warning(as_found, f"{LOST}; this is the motion as it was found")
    why = finished.verdict.reason
    if not as_found.verdict.free or ends is not None:
        return as_found if as_found.verdict.free or why is Reason.CONTACT else finished
    message = f"the optimised motion was not certified ({why.value}); this is the motion as it was found"
    return _blend(problem, finished, as_found, stages) or _add_warning(as_found, message)


def _keep_limits(
    problem: Problem, finished: CertifiedMotion, found: PathSoFar, stages: Stages, ends: MovingEnds | None
) -> CertifiedMotion:
    """The optimised motion; where it exceeds limits of the whole, and the path as found doesn't, one nearer to that."""
    if problem.deadline.expired() or not is_overloaded(problem, finished):
        return finished
    as_found = certify_found_path(problem, found, stages, ends)
    if not as_found.verdict.free or is_overloaded(problem, as_found):
        return finished
    nearer = _blend(problem, finished, as_found, stages) if ends is None else None
    return nearer or _add_warning(as_found, OVERLOADED)


def certify_found_path(
    problem: Problem, found: PathSoFar, stages: Stages, ends: MovingEnds | None = None
) -> CertifiedMotion:
    """The motion along a path as found, as fast as its limits or its schedule allow, certified as far as it goes."""
    if found.failure is not None:
        return certify_as_far_as_found(problem, found, stages)
    if ends is None:
        return _follow_path(problem, found, stages)
    middle = _follow_path(ends.between(problem), found, stages)
    if middle.trajectory is None:
        return middle
    trajectory = ends.around(middle.trajectory)
    whole = certify_motion(problem, trajectory, {}, stages, message="with how it stops, and gets up to speed")
    stops = (STOPS,) if problem.optimization_iterations != 0 else ()
    return replace(whole, warnings=(*middle.warnings, *stops))


def _optimize_path(
    problem: Problem, found: PathSoFar, stages: Stages, ends: MovingEnds | None
) -> CertifiedMotion | None:
    """The optimised trajectory from the time-optimal one along the path; where it is refused, optimised again.

    None where it can't be brought onto a guide plane.
    """
    resting = problem if ends is None else ends.between(problem)

    def time(path: LocalPoints) -> Trajectory:
        if ends is None:
            return time_through_planes(problem, found, path)
        return ends.around(
            time_path_ignoring_jerk(resting, path, resting.motion_limits)
        )  # its time isn't scaled in the end

    with stages.enter("parameterize", "as fast as the limits allow along the path") as stage:
        motion = time(found.path)
        stage.outcome = f"{motion.duration:.3f} s"
    others = map(time, found.others)
    return optimize_motion(problem, motion, others, stages, CrossedPlanes.of(problem, found.path, found.crossings))


def time_through_planes(problem: Problem, found: PathSoFar, path: LocalPoints) -> Trajectory:
    """The fastest motion along a path (n, nv) of what was found, whatever its jerk; between guide planes straighter."""
    return time_path_ignoring_jerk(
        problem, remove_waypoints(problem, path, found.crossings) if found.crossings else path
    )


def _follow_path(problem: Problem, found: PathSoFar, stages: Stages) -> CertifiedMotion:
    crossed, finished = CrossedPlanes.of(problem, found.path, found.crossings), None
    for repair in range(REPAIRS + 1):
        with stages.enter("parameterize", "as fast as the limits allow, round the corners") as stage:
            made = _round_corners(problem, found.path, crossed, 2**repair)
            stage.outcome = LOST if made is None else f"{made[0].duration:.3f} s"
        if made is None:
            continue
        finished = certify_motion(problem, *made, stages)
        if finished.verdict.free or _is_hopeless(problem, found.path, finished) or problem.deadline.expired():
            return finished
    with stages.enter("parameterize", "as fast as the limits allow, with a stop at each corner") as stage:
        trajectory, knots = time_path_with_stops(problem, found.path)
        stage.outcome = f"{trajectory.duration:.3f} s"
    stopping = certify_motion(problem, trajectory, {plane: knots[at] for plane, at in found.crossings.items()}, stages)
    return _add_warning(stopping, STOPPING) if finished is None or stopping.verdict.free else finished


def _blend(
    problem: Problem, refused: CertifiedMotion, certified: CertifiedMotion, stages: Stages
) -> CertifiedMotion | None:
    """Return the certified motion nearest to a refused one between that and one that is certified.

    None where none is certified and quicker than that one, and where guide planes are crossed.
    """
    motions = [one.trajectory for one in (refused, certified)]
    if certified.crossings or None in motions or problem.path_constraints:
        return None
    shares = np.linspace(0.0, 1.0, BLEND_PLACES)
    far, near = (one.evaluate(one.times[0] + one.duration * shares)[0] for one in motions if one is not None)
    for share in BLENDS:
        if problem.deadline.expired():
            break
        with stages.enter("parameterize", f"{share:.0%} of the way to the refused motion") as stage:
            motion = time_path(problem, cast(LocalPoints, near + share * (far - near)))
            stage.outcome = f"{motion.duration:.3f} s"
        if certified.trajectory is None or motion.duration >= certified.trajectory.duration:
            continue
        made = certify_motion(problem, motion, {}, stages)
        if made.verdict.free and not is_overloaded(problem, made):
            return made
    return None


def _round_corners(
    problem: Problem, path: LocalPoints, crossed: CrossedPlanes, finer: int
) -> tuple[Trajectory, dict[int, int]] | None:
    if not crossed.passages:
        trajectory = time_path(problem, path, finer)
        return trajectory, crossed.knots(trajectory, ())
    return bring_onto_planes(problem, round_path(problem, path, limits_of(problem), finer), crossed)


def _add_warning(finished: CertifiedMotion, warning: str) -> CertifiedMotion:
    return replace(finished, warnings=(warning, *finished.warnings))


def _is_hopeless(problem: Problem, path: LocalPoints, finished: CertifiedMotion) -> bool:
    verdict = finished.verdict
    if verdict.piece is None or len(path) < 2:
        return True
    assert finished.trajectory is not None, "its verdict names a piece"
    place = finished.trajectory.bezier()[verdict.piece].mean(axis=0)
    return _find_refused_place(problem, _find_nearest(path, place), verdict.reason)


def _find_refused_place(problem: Problem, z: LocalPoint, reason: Reason) -> bool:
    match reason:
        case Reason.BEYOND_LIMITS:
            lower, upper = problem.group.lower - LIMIT_TOLERANCE, problem.group.upper + LIMIT_TOLERANCE
            return bool(((z < lower) | (z > upper)).any())
        case Reason.TOO_CLOSE:
            return (
                clearance_at(problem.world, problem.group.expand_from_local(z)).obstacle_distance
                < problem.min_clearance
            )
        case Reason.CONTACT:
            return problem.world.in_collision(problem.group.expand_from_local(z))
    return False


def _find_nearest(path: LocalPoints, place: LocalPoint) -> LocalPoint:
    along = np.diff(path, axis=0)
    share = np.einsum("ij,ij->i", place - path[:-1], along) / np.maximum(np.einsum("ij,ij->i", along, along), 1e-30)
    nearest = path[:-1] + np.clip(share, 0.0, 1.0)[:, None] * along
    return cast(LocalPoint, nearest[int(np.argmin(np.linalg.norm(place - nearest, axis=1)))])


def remove_waypoints(problem: Problem, path: LocalPoints, crossings: Mapping[int, int]) -> LocalPoints:
    """A path (n, nv) with the same ends, no longer, through the same waypoints on guide planes.

    Between them straight paths are taken that keep a distance from obstacles; where there is none the path stays.
    """
    if problem.path_constraints:  # which a straight path would leave
        return path
    kept = sorted({0, len(path) - 1, *crossings.values()})
    margin = problem.min_clearance + STRAIGHT_MARGIN * problem.group.size
    shortened = [problem.batch.shorten(path[begin : end + 1], RESOLUTION, margin) for begin, end in pairwise(kept)]
    return np.concatenate([path[:1], *(part[1:] for part in shortened)])


@dataclass(frozen=True, eq=False)
class MovingEnds(ReadOnly):
    """The first part of a motion, to rest, and for each goal the last part, from rest to its velocities."""

    stop: Trajectory
    goals: LocalPoints  # local coordinates (m, nv) of the goals that can be reached so
    runs: tuple[Trajectory, ...]

    @property
    def inner_goals(self) -> LocalPoints:
        """The local coordinates of rest before each goal, shape (m, nv)."""
        return np.array([run.positions[0] for run in self.runs])

    def between(self, problem: Problem) -> Problem:
        """The problem from when and where the robot has come to rest."""
        return problem.since(self.stop.duration, problem.group.from_local(self.stop.positions[-1]))

    def around(self, middle: Trajectory) -> Trajectory:
        """A motion from rest to rest between the two, with them before and after it."""
        end = middle.positions[-1]
        away = [np.abs((end - run.positions[0] + np.pi) % (2.0 * np.pi) - np.pi).max() for run in self.runs]
        run = self.runs[int(np.argmin(away))]
        turned = run.positions + (end - run.positions[0])  # whole turns may have been added
        return concatenate([unwrap_towards(self.stop, middle), middle, Trajectory(run.times, turned, run.velocities)])


def moving_ends(problem: Problem, goals: LocalPoints, stages: Stages) -> MovingEnds:
    """Plan how a problem's ends are left and reached in motion; goals are local coordinates (m, nv), free.

    Raises:
        StageFailed: START_STATE_INVALID or GOAL_STATE_INVALID, with the joint that can't keep its limits, or can't stop
            in time, and why.
    """
    with stages.enter("ends", "out of the start's velocities, into the goal's") as stage:
        _require_within(problem, _START, problem.start_rates, problem.start_acceleration)
        _require_within(problem, _GOAL, problem.end_rates, None)
        _require_within_whole(problem, _START, problem.z_start, problem.start_rates, problem.start_acceleration)
        stop = _stop_within_limits(problem, _START, problem.z_start, problem.start_rates, problem.start_acceleration)
        reached: list[tuple[LocalPoint, Trajectory]] = []
        failures: list[StageFailed] = []
        once_at_rest = problem.at(problem.scene.end)
        for goal in goals:
            try:
                _require_within_whole(problem, _GOAL, goal, problem.end_rates, None)
                run = reverse_motion(_stop_within_limits(once_at_rest, _GOAL, goal, -problem.end_rates, None))
                reached.append((goal, run))
            except StageFailed as failed:
                failures.append(failed)
        if not reached:
            raise failures[0]
        stage.outcome = f"at rest after {stop.duration:.3f} s"
    return MovingEnds(stop, np.array([goal for goal, _ in reached]), tuple(run for _, run in reached))


@dataclass(frozen=True)
class _EndWords:
    status: Status
    stage: str
    field: str
    verb: str


_START = _EndWords(Status.START_STATE_INVALID, "start", "start_velocities", "stop")
_GOAL = _EndWords(Status.GOAL_STATE_INVALID, "goal", "end_velocities", "get up to speed")


def _require_within(problem: Problem, end: _EndWords, velocity: LocalRate, acceleration: LocalRate | None) -> None:
    """Refuse what is beyond the limits of a joint, or will be whatever it does."""
    group = problem.group
    names = group.velocity_names
    for j, name in enumerate(names):
        v, top = float(velocity[j]), float(group.velocity_limits[j])
        if abs(v) > top * (1.0 + TOLERANCE):
            raise _make_refusal(
                end, name, f"`{end.field}` has joint {name} at {v:.6g}, its limit is {top:.6g}", limit=top
            )
        if acceleration is None:
            continue
        a, most = float(acceleration[j]), float(group.acceleration_limits[j])
        if abs(a) > most * (1.0 + TOLERANCE):
            message = f"`start_accelerations` has joint {name} at {a:.6g}, its limit is {most:.6g}"
            raise _make_refusal(end, name, message, limit=most)
        jerk = np.inf if problem.jerk_limits is None else float(problem.jerk_limits[j])
        reached = abs(v) + a * a / (2.0 * jerk)
        if v * a > 0.0 and (reached > top * (1.0 + TOLERANCE) or (jerk == np.inf and abs(v) >= top)):
            message = (
                f"joint {name} can't keep its velocity limit of {top:.6g}: with the acceleration at the start it"
                f" reaches {reached:.6g} at least"
            )
            raise _make_refusal(end, name, message, limit=top, reached=reached)


def _require_within_whole(
    problem: Problem, end: _EndWords, z: LocalPoint, velocity: LocalRate, acceleration: LocalRate | None
) -> None:
    still = np.zeros_like(velocity)
    rows = [cast(LocalRates, row[None]) for row in (velocity, still if acceleration is None else acceleration)]
    point = cast(LocalPoints, z[None])
    for limit in problem.cartesian_limits:
        speed = limit.speed / math.sqrt(float(limit.along(point, rows[0], cast(LocalRates, still[None])).caps[0]))
        if speed > limit.speed * KEPT_SHARE:
            kind = "link" if limit.is_link else "frame"
            message = f"`{end.field}` move {kind} {limit.name!r} at {speed:.6g} m/s, its limit is {limit.speed:g} m/s"
            raise StageFailed(
                end.status, message, stage=end.stage, speed=speed, limit=limit.speed, **{kind: limit.name}
            )
    effort = problem.effort_limit
    if effort is None:
        return
    torques = torques_of(effort.tree, point, *rows)[0]
    worst = int(np.argmax(np.abs(torques) / effort.limits))
    most, name = float(effort.limits[worst]), effort.names[worst]
    if abs(torques[worst]) > most * KEPT_SHARE:
        message = f"with `{end.field}` joint {name} takes {torques[worst]:.6g} N m, its limit is {most:g} N m"
        raise _make_refusal(end, name, message, effort=float(torques[worst]), limit=most)


def _stop_within_limits(
    problem: Problem, end: _EndWords, z: LocalPoint, velocity: LocalRate, acceleration: LocalRate | None
) -> Trajectory:
    """The motion to rest; at a goal that of time running backwards."""
    group = problem.group
    still = cast(LocalRate, np.zeros(group.nv))
    rise = still if acceleration is None else acceleration
    room = group.velocity_limits - np.abs(velocity)
    rises = np.where(velocity * rise > 0.0, rise**2 / (2.0 * np.maximum(room, 1e-300)), 0.0)
    jerks = choose_jerks(group.acceleration_limits, problem.jerk_limits, rises)
    jerks = separate_jerks(velocity, rise, group.acceleration_limits, jerks, rises)
    motion = stop_motion(z, velocity, rise, group.acceleration_limits, jerks)
    if motion.duration == 0.0:
        return motion
    verdict = judge_itself(problem, motion)
    problem.counters.collision_checks += verdict.evaluations
    if verdict.free:
        return motion
    if verdict.reason is Reason.BEYOND_LIMITS and verdict.beyond is not None:
        fault = verdict.beyond
        j = group.velocity_names.index(fault.joint)
        limit = fault.upper if fault.value > fault.upper else fault.lower
        message = (
            f"joint {fault.joint} can't {end.verb} in time: at {abs(float(velocity[j])):.6g} it takes"
            f" {abs(float(motion.positions[-1, j] - z[j])):.6g}, and its limit of {limit:.6g} is"
            f" {abs(limit - float(z[j])):.6g} away"
        )
        raise _make_refusal(end, fault.joint, message, limit=limit, pair=None)
    slowest = int(np.argmax(np.abs(velocity) / group.acceleration_limits))
    name, pair = group.velocity_names[slowest], " and ".join(verdict.pair) if verdict.pair else "bodies"
    message = (
        f"the robot can't {end.verb} in time: {verdict.reason.value} between {pair} within the"
        f" {motion.duration:.3f} s that it takes, most of all joint {name}"
    )
    raise _make_refusal(end, name, message, pair=list(verdict.pair) if verdict.pair else None, duration=motion.duration)


def _make_refusal(end: _EndWords, joint: str, message: str, **details: Any) -> StageFailed:
    return StageFailed(end.status, message, stage=end.stage, joint=joint, **details)
