"""Connect to goals and planes; find paths as if moving obstacles were gone, or stood where they are at chosen times.

`goal_among_movers.py` schedules and certifies the paths, `plan.py` and it the connections: the order of holdings and
the shares of time (here, and `PATH_SEARCH` of slices.py) change which is found, not what is free. A holding's draw
seeds its search, so a new one belongs at the end.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from guidefield.errors import Status
from guidefield.planner.connect import Connection, Keeper, connect, connect_constrained, find_quickest_path
from guidefield.planner.ends import UNREACHED, find_tip_points
from guidefield.planner.guide.guide import inset_of
from guidefield.planner.path_so_far import PathSoFar
from guidefield.planner.slices import PATH_SEARCH, Slices, build_held_world
from guidefield.planner.task.problem import Problem
from guidefield.planner.task.stages import Ending, Stage, StageFailed, Stages
from guidefield.planner.task.trace import Note
from guidefield.read_only import ReadOnly
from guidefield.robot.group.inverse_kinematics import EXACT, PoseTarget
from guidefield.robot.model.joints import LocalPoint, LocalPoints
from guidefield.scene.guide_plane import GuidePlane, axes_across

FIRST_TRY_SHARE = 0.5
"""Share of the time for a connection before a lesser one is searched for: from the start instead of from where derived
guide planes led; with no more than contact avoided instead of with the required clearance."""


def connect_to_plane(problem: Problem, found: PathSoFar, stuck: PathSoFar, index: int, stage: Stage) -> PathSoFar:
    """Reach a guide plane, with any orientation, from where the approach to it began.

    Else an approach that got stuck stays failed, with both reasons.
    """
    try:
        reached = connect_to_goal(
            problem, found, _points_on(problem, problem.guide_planes[index], stuck.path[-1]), stage
        )
    except StageFailed as failed:
        reached = found.with_failure(failed.ending)
    if reached.failure is None:
        return reached
    if stuck.failure is None:
        return reached
    message = f"{stuck.failure.message}; the tree got no further either: {reached.failure.message}"
    stage.outcome = stage.outcome or message
    return stuck.with_failure(Ending(stuck.failure.status, message, stuck.failure.details))


def _points_on(problem: Problem, plane: GuidePlane, stuck: LocalPoint) -> LocalPoints:
    tip = problem.kinematics.tip_position(problem.group.expand_from_local(stuck))
    place = plane.closest_point(tip, inset_of(problem, plane))
    try:
        return find_tip_points(problem, PoseTarget(pin.SE3(np.eye(3), place), np.zeros(3), np.full(3, np.inf)))
    except StageFailed as failed:
        if failed.ending.status not in UNREACHED:
            raise
    return find_tip_points(problem, _within(problem, plane))


def _within(problem: Problem, plane: GuidePlane) -> PoseTarget:
    """The tip anywhere in a square in the middle of a plane, as large as stays inside, with any orientation."""
    inset, across = inset_of(problem, plane), axes_across(plane.normal)
    centre = plane.closest_point(plane.centroid, inset)
    corners = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]) @ across
    half = plane.inradius
    while half > EXACT and not all(plane.contains(centre + half * corner, inset) for corner in corners):
        half *= 0.5
    rotation = np.column_stack([*across, np.cross(*across)])
    return PoseTarget(pin.SE3(rotation, centre), np.array([half, half, 0.0]), np.full(3, np.inf))


def connect_to_goal(
    problem: Problem, found: PathSoFar, goals: LocalPoints, stage: Stage, *, prove: bool = True
) -> PathSoFar:
    """Go on to one of some goals (m, nv); failed where it ends if no connection is found, or time is up.

    If nothing leads on from where guide planes led that nobody gave, a connection begins anew at the start.
    """
    led = len(found.path) > 1 and max(found.crossings, default=-1) < problem.derived_planes
    connection = _try_connection(_in_part_of_the_time(problem) if led else problem, found, goals, prove)
    if led and connection.status is not Status.SUCCESS and not problem.deadline.expired():
        problem.tell(Note("nothing leads on from where derived guide planes led: the connection begins at the start"))
        found = found.back_at_start()
        connection = _try_connection(problem, found, goals, prove)
    stage.outcome = connection.message
    if connection.status is not Status.SUCCESS:
        return found.with_failure(Ending(connection.status, connection.message, {"stage": "connect"}))
    return found.extend(connection.path, proven=connection.proven, others=connection.others)


def connections(
    problem: Problem, found: PathSoFar, goals: LocalPoints, stages: Stages, words: str
) -> Iterator[PathSoFar]:
    """Connections to one of some goals (m, nv), until a motion is certified; the second one is proven."""
    for prove in (False, True):
        if prove:
            problem.tell(Note("the motion was not certified: the connection is certified before it is made one again"))
        with stages.enter("connect", f"{words}{', certified' if prove else ''}") as stage:
            connected = connect_to_goal(problem, found, goals, stage, prove=prove)
        yield connected
        if connected.proven or connected.failure is not None or problem.deadline.expired():
            return


def _try_connection(problem: Problem, found: PathSoFar, goals: LocalPoints, prove: bool) -> Connection:
    rng = np.random.default_rng([problem.seed, 2])
    if problem.path_constraints:
        keeper = Keeper(problem, problem.constrained_frames)
        return connect_constrained(problem, keeper, found.path[-1], goals, rng)
    return _connect_with_clearance(problem, found, goals, rng, prove)


def _connect_with_clearance(
    problem: Problem, found: PathSoFar, goals: LocalPoints, rng: np.random.Generator, prove: bool
) -> Connection:
    part = _in_part_of_the_time(problem) if problem.min_clearance > 0.0 else problem
    connection = connect(part, found.path[-1], goals, rng, prove=prove)
    if connection.status is not Status.SUCCESS and problem.min_clearance > 0.0 and not problem.deadline.expired():
        problem.tell(Note("no connection keeps the clearance asked for: optimising may make one of any that is free"))
        problem = dataclasses.replace(problem, min_clearance=0.0)
        connection = connect(problem, found.path[-1], goals, rng, prove=prove)
    return connection


def _in_part_of_the_time(problem: Problem) -> Problem:
    return dataclasses.replace(problem, deadline=problem.deadline.share(FIRST_TRY_SHARE))


@dataclass(frozen=True, eq=False)
class HeldPath(ReadOnly):
    """A path to a goal among obstacles that are held."""

    name: str  # how the obstacles are held, in words
    problem: Problem  # among these obstacles
    found: PathSoFar
    at_rest: bool = False  # whether it is among the obstacles as they come to rest
    detour: bool = False  # whether it goes by a place to wait at, so that it may not be made shorter


Through = Callable[[Problem, PathSoFar, bool], tuple[PathSoFar, LocalPoints | None]]
"""Leads a motion through the guide planes of a problem, if there are any, by all attempts (True) or by the first one;
returns it with the goals (m, nv) after them, None where the last plane is the goal."""


def find_quick_paths(problem: Problem, through: Through) -> Iterator[HeldPath]:
    """Paths that a few motions find, one after the other, through the guide planes to goals.

    Obstacles that bar the planes where they are at a time do so wherever they are until later.
    """
    crossed: dict[Problem, tuple[PathSoFar, LocalPoints | None]] = {}
    barred = np.inf
    for draw, holding in enumerate(_hold_obstacles(problem)):
        among = holding.among
        if problem.deadline.expired():
            return
        if holding.swept and barred <= holding.time:
            continue
        if among.batch.touching(problem.z_start[None], problem.min_clearance)[0]:
            continue
        rng = np.random.default_rng([problem.seed, 5, draw])
        if among not in crossed:
            crossed[among] = through(among, PathSoFar.at_start(among), False)
            if crossed[among][0].failure is not None:
                barred = min(barred, holding.time)
        if (found := _reach_goal(among, *crossed[among], rng)) is not None:
            yield HeldPath(holding.name, among, found, holding.at_rest)


def _go_on(among: Problem, found: PathSoFar, through: Through, rng: np.random.Generator) -> PathSoFar | None:
    """Go on from where a motion ends, through the guide planes to the nearest free goal, by a few motions."""
    return _reach_goal(among, *through(among, found, False), rng)


def _reach_goal(
    among: Problem, found: PathSoFar, goals: LocalPoints | None, rng: np.random.Generator
) -> PathSoFar | None:
    if found.failure is not None or goals is None:
        return found if found.failure is None else None
    free = goals[~among.batch.touching(goals, among.min_clearance)]
    here = found.path[-1]
    near = np.array([among.group.unwrapped(goal, here) for goal in free])
    quickest = find_quickest_path(among, here, near, rng) if len(near) else None
    return None if quickest is None else found.extend(quickest.path, proven=False, others=quickest.others)


def find_detours(problem: Problem, through: Through, slices: Slices, since: float) -> Iterator[HeldPath]:
    """Paths by places to wait at, where the robot can't stay from a time on [s]; those that are free longest first."""
    rng, among, last = np.random.default_rng([problem.seed, 6]), _among(problem, {}), problem.at(problem.scene.end)
    places = _places(among, rng)
    if not len(places):
        return
    blocked = np.zeros(len(places), int)
    for index in range(int(since / slices.length), slices.resting_from + 1):
        if problem.deadline.expired():
            return
        blocked += slices.touching(index, places)
    for place in places[np.argsort(blocked, kind="stable")[: PATH_SEARCH.detours]]:
        if problem.deadline.expired():
            return
        there = find_quickest_path(among, problem.z_start, place[None], rng)
        if there is None:
            continue
        found = PathSoFar.at_start(among).extend(there.path, proven=False)
        onward = _go_on(last, found, through, rng) or _go_on(among, found, through, rng)
        if onward is not None:
            yield HeldPath("by a place to wait at", among, onward, detour=True)


def _places(among: Problem, rng: np.random.Generator) -> LocalPoints:
    group, half = among.group, PATH_SEARCH.places // 2
    noise = rng.normal(scale=PATH_SEARCH.deviation, size=(half, group.nv)) * group.units
    anywhere = np.array([group.to_local(group.random(rng)) for _ in range(half)])
    drawn = np.clip(np.concatenate([among.z_start + noise, anywhere]), group.lower, group.upper)
    free: LocalPoints = drawn[~among.batch.touching(drawn, among.min_clearance)]
    return free


@dataclass(frozen=True, eq=False)
class _Holding(ReadOnly):
    name: str  # in words
    among: Problem  # among them
    time: float = np.inf  # when they are there [s]; infinite: they aren't there at all
    swept: bool = False  # whether they are wherever they are until then
    at_rest: bool = False  # whether they are where they come to rest


def _hold_obstacles(problem: Problem) -> Iterator[_Holding]:
    end, alone = problem.scene.end, _among(problem, {})
    moving = {index: one.motion for index, one in enumerate(problem.scene.obstacles) if one.motion is not None}
    known: dict[bytes, Problem] = {}

    def hold(time: float) -> Problem:
        """Those that stay where they are are held once."""
        places = b"".join(motion.at(time).homogeneous.tobytes() for motion in moving.values())
        if places not in known:
            known[places] = problem.at(time)
        return known[places]

    yield _Holding("among what rests", alone)
    yield _Holding("where they come to rest", hold(end), end, at_rest=True)
    for share in PATH_SEARCH.moments:
        yield _Holding(f"where they are at {problem.began + share * end:.2f} s", hold(share * end), share * end)
    times = (np.arange(PATH_SEARCH.swept) + 0.5) / PATH_SEARCH.swept
    for until in (0.5 * end, end):
        among = _among(problem, dict.fromkeys(moving, (until * times).tolist()))
        yield _Holding(f"wherever they are until {problem.began + until:.2f} s", among, until, swept=True)
    for _ in range(PATH_SEARCH.draws - 1):
        yield _Holding("among what rests, again", alone)


def without_movers(problem: Problem) -> Problem:
    """The problem without the obstacles that move."""
    return _among(problem, {}) if problem.scene.moves else problem


def _among(problem: Problem, moments: dict[int, Sequence[float]]) -> Problem:
    at_rest = {index: (0.0,) for index, one in enumerate(problem.scene.obstacles) if one.motion is None}
    world = build_held_world(problem, {**at_rest, **moments})
    return dataclasses.replace(
        problem, scene=world.scene, world=world, robot_field=problem.robot_field.among(world.scene)
    )
