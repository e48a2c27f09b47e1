"""Moving obstacles as obstacles at rest: copies over each slice of time, or standing where they are at chosen times.

`SCHEDULE` and `PATH_SEARCH` are the settings of schedules and of paths among what moves (`schedule.py`,
goal_among_movers.py, held_paths.py): larger counts and finer slices find more, and take longer; but finer rates and
steps reach `most_steps` and `most_states` sooner, and then find less. service/docs/algorithm.md has `rates` and
`slice_length`. Schedules are proposals to the certificate; until when a place is free is its own verdict
(`find_free_until`, `find_free_from`).
"""

from __future__ import annotations

import dataclasses
import math
from bisect import bisect_left, bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
import pinocchio as pin

from guidefield.collision.batch.batch_collision import BatchCollision
from guidefield.collision.pairs import Pairs
from guidefield.collision.world import World
from guidefield.geometry.surfaces import transform_points
from guidefield.messages import scene as messages
from guidefield.planner.task.problem import Problem
from guidefield.prove.certificate import certify_moving
from guidefield.prove.verdict import Verdict
from guidefield.robot.model.joints import LocalPoint
from guidefield.robot.model.model import MARGIN
from guidefield.scene import obstacle as obstacles
from guidefield.scene.cloud import covering
from guidefield.scene.movers import MovingBall, motion_of, movers
from guidefield.scene.obstacle import Obstacle
from guidefield.scene.obstacle_message import count_of, put_at


@dataclass(frozen=True)
class ScheduleSettings:
    """The settings of the search for a schedule along a path."""

    rates: int = 8  # rates above 0 that a schedule may have, evenly up to 1. A choice
    changes: int = 4  # by how many of them it may change in one step at most, up to 127. A choice
    braking: float = 2.0  # so much of a rate changes in a step at the acceleration limits at most. A choice
    shortest_step: float = 0.02  # a step lasts at least, and at most, so long [s]. Choices
    longest_step: float = 0.2  # together with the one above
    slice_length: float = 0.05  # obstacles are examined in slices of time at most this long [s]. A choice
    together: int = 4  # slices that are examined as one first. A choice
    # an obstacle that moves by more than twice this in a slice stands there more than once [m]; a choice
    finest: float = 0.01
    most_copies: int = 6  # so often at most. A choice
    most_triangles: int = 200  # a moving mesh of more stands in slices as the box about it. A choice
    most_points: int = 500  # a moving cloud of more is covered by this many larger ones. A choice
    far: float = 5.0  # how far a joint without limits slides, for the speed of half-spaces [m]. A choice
    resolution: float = (
        32.0  # cells of a path per length in local coordinates [1/rad or 1/m], as samples of a tree's motions
    )
    most_cells: int = 1000  # cells of a path at most. A choice
    fine: int = 4  # times for each knot of a motion at which the distance travelled is measured. A choice
    steps_at_once: int = 4  # steps that are followed between two checks of the deadline. A choice
    most_steps: int = 4096  # after this many steps no search goes on. A choice: four minutes of a Panda's
    most_states: int = 40_000_000  # a search keeps this many states at most, of 8 bits each. A choice
    # after all obstacles have come to rest the search goes on for this many times what the path takes, and a second. A
    # choice: what arrives then could have gone before
    slack: float = 1.5
    # shares of its limits that the path's motion uses, as stretched in time, where its rate changes: the rest of
    # them is for changes of rate. Choices, tried in order
    rooms: tuple[float, ...] = (0.97, 0.85, 0.7)
    repairs: int = 8  # how often a refused place is taken out, and a schedule looked for again. A choice
    # where what moves keeps this, and the required clearance, from a motion that it doesn't delay, no better one is
    # looked for [m]: the range of the optimisation's barrier
    distance: float = 0.08
    kept_slices: int = 400  # slices whose tables are kept. A choice


SCHEDULE = ScheduleSettings()


@dataclass(frozen=True)
class PathSearchSettings:
    """The settings of the paths along which schedules are searched for."""

    # shares of the time until all obstacles rest, at which they are held for a path among them. A choice
    moments: tuple[float, ...] = (0.0, 0.33, 0.67)
    swept: int = 8  # moments of a motion at which each obstacle represents a path round it. A choice
    draws: int = 3  # paths among what rests alone. A choice
    places: int = 256  # random places that are examined, where the robot has to wait elsewhere. A choice
    # how far from the start half of them lie, as a standard deviation [rad, or the group's unit of length]. A choice
    deviation: float = 0.7
    detours: int = 12  # by how many of them a path is tried. A choice
    rooms: tuple[float, ...] = (0.85,)  # as those of a schedule, where a path is but estimated. A choice
    share: float = 0.5  # of the time left for paths that a few motions find. A choice
    # a path of at most this times the time without obstacles, or until a goal stays free, ends the search. A choice
    unhindered: float = 1.05
    patience: int = 4  # this many paths in a row that arrive no sooner, by a step, end it as well. A choice


PATH_SEARCH = PathSearchSettings()


Moments = Mapping[int, Sequence[float]]
"""At which times [s] each obstacle of a scene, by its index, stands; one that rests, at any single one."""


def build_held_world(problem: Problem, moments: Moments) -> World:
    """The robot among some obstacles of its scene, each standing where it is at one or more times.

    What may touch an obstacle may touch all of these.
    """
    return _world(problem, moments, problem.world.pairs.own)


def _world(problem: Problem, moments: Moments, own: np.ndarray) -> World:
    standing, of = [], []
    for index, times in moments.items():
        one = problem.scene.obstacles[index]
        standing += [one] if one.motion is None else [_standing(one, time) for time in times]
        of += [index] * (1 if one.motion is None else len(times))
    names = _distinct([one.name for one in standing])
    standing = [_rename(one, name) for one, name in zip(standing, names, strict=True)]
    message = msgspec.structs.replace(problem.scene.message, obstacles=[one.message for one in standing])
    scene = dataclasses.replace(problem.scene, message=message, obstacles=tuple(standing), warnings=())
    return World(
        problem.group, scene, _pairs(problem.world.pairs, np.array(of, np.int64), own), problem.world.held_contacts
    )


def _rename(one: Obstacle, name: str) -> Obstacle:
    """The obstacle by a name; itself if it has it, with all that is known about it."""
    if one.name == name:
        return one
    return dataclasses.replace(one, message=msgspec.structs.replace(one.message, name=name))


def _distinct(names: list[str]) -> list[str]:
    """The names, with strokes where one has been before."""
    given, taken = set(names), dict[str, None]()
    for name in names:
        distinct = name
        while distinct in taken or (distinct != name and distinct in given):
            distinct += "'"
        taken[distinct] = None
    return list(taken)


def _pairs(pairs: Pairs, of: np.ndarray, own: np.ndarray) -> Pairs:
    rows, left_out = np.divmod(pairs.left_out, max(1, pairs.obstacles))
    found = [
        int(row) * len(of) + int(at)
        for row, one in zip(rows, left_out, strict=True)
        for at in np.flatnonzero(of == one)
    ]
    return Pairs(own, pairs.links, pairs.moving, len(of), np.array(sorted(found), np.int64))


def _standing(one: Obstacle, time: float) -> Obstacle:
    """An obstacle that moves, at rest where it is at a time [s].

    For one of very many triangles stands the box about it, for a cloud of very many points one of fewer and larger.
    """
    assert one.motion is not None, "it moves"
    if isinstance(one.message, messages.Mesh) and count_of(one.message.triangles) > SCHEDULE.most_triangles:
        return obstacles.build(_box_about(one, time), 0)
    if one.cloud is not None and len(one.cloud.points) > SCHEDULE.most_points:
        few = covering(one.cloud, SCHEDULE.most_points)
        points = transform_points(one.placement_at(time), few.points).tolist()
        return obstacles.build(messages.PointCloud(name=one.name, points=points, radius=few.radius), 0)
    return obstacles.build(put_at(one.message, one.motion.at(time)), 0)


def _box_about(one: Obstacle, time: float) -> messages.Box:
    """The box about an obstacle that moves, along the axes of its own frame, where it is at a time [s]."""
    low, high = one.box
    placement = one.placement_at(time) * pin.SE3(np.eye(3), 0.5 * (low + high))
    return messages.Box(
        name=one.name,
        size=tuple(np.maximum(high - low, 1e-6).tolist()),
        position=tuple(placement.translation.tolist()),
        quaternion_xyzw=tuple(pin.Quaternion(placement.rotation).normalized().coeffs().tolist()),
    )


class Slices:
    """A robot among the obstacles that move, in slices of time of one length.

    In a slice an obstacle stands where it is at one moment, or at several if it is fast, and is kept from by as much
    more as it moves about them. From when all have come to rest on, they stand where they are.

    Args:
        length: Of a slice [s].
    """

    def __init__(self, problem: Problem, length: float) -> None:
        self._problem = problem
        self.length = length
        self.resting_from = math.ceil(max(problem.scene.end, 0.0) / length)
        known, pairs = movers(problem.scene), problem.world.pairs
        self._balls = {
            int(index): ball
            for index, ball in zip(known.indices, known.balls, strict=True)
            if len(pairs.of_obstacles(np.array([index])))
        }
        self._within_reach = _reach(problem.world) if None in self._balls.values() else None
        self._kept: dict[tuple[int, int], tuple[BatchCollision, float]] = {}

    def touching(self, index: int, zs: np.ndarray, together: int = 1) -> np.ndarray:
        """The points (n, nv) that may touch in a slice, by its index, or in one of several; shape (n,), bool.

        Several of them count as slices of as many times the length.
        """
        key = min(index, math.ceil(self.resting_from / together)), together
        if key not in self._kept:
            while len(self._kept) >= SCHEDULE.kept_slices:
                self._kept.pop(next(iter(self._kept)))
            self._kept[key] = self._slice(*key)
        batch, clearance = self._kept[key]
        self._problem.counters.collision_checks += len(zs)
        return batch.touching(zs, clearance)

    def _slice(self, index: int, together: int) -> tuple[BatchCollision, float]:
        length, moving = together * self.length, index * together < self.resting_from
        kept, begin, end = self._problem.min_clearance, index * length, (index + 1) * length
        size = self._problem.group.size
        moments, moves = {}, 0.0
        for mover, ball in self._balls.items():
            travel = 0.5 * self._speed(mover, ball, begin, end) * length if moving else 0.0
            copies = int(np.clip(math.ceil(travel / (together * SCHEDULE.finest * size)), 1, SCHEDULE.most_copies))
            moments[mover] = (begin + (np.arange(copies) + 0.5) / copies * length).tolist()
            moves = max(moves, travel / copies)
        if moving:
            kept += MARGIN * size + moves
        return BatchCollision.build(_world(self._problem, moments, np.empty((0, 2), np.int64))), kept

    def _speed(self, mover: int, ball: MovingBall | None, begin: float, end: float) -> float:
        """Largest speed of an obstacle between two times; of a half-space within the robot's reach [m/s]."""
        known = movers(self._problem.scene)
        at = bisect_left(known.indices, mover)
        times = known.times[at]
        first, last = bisect_right(times, begin) - 1, bisect_left(times, end)
        if ball is not None:
            return max(known.speeds[at][max(first, 0) : last], default=0.0)
        assert self._within_reach is not None, "one of the balls is missing"
        passing = motion_of(known.obstacles[at]).passing(*self._within_reach)[1:-1]
        return float(passing[max(first, 0) : last].max(initial=0.0))


def _reach(world: World) -> tuple[np.ndarray, float]:
    """A ball that the robot's moving bodies stay in: centre (3,) [m, world] and radius [m]; see `SCHEDULE.far`."""
    group, model, bodies = world.group, world.model, world.bodies
    most = np.maximum(np.abs(group.lower), np.abs(group.upper))
    slides = np.abs(group.expand_velocity) @ np.where(np.isfinite(most), most, SCHEDULE.far)
    slides[bodies.turns] = 0.0
    centre, out = np.array(model.jointPlacements[1].translation), np.zeros(model.njoints)
    for i, joint in enumerate(model.joints[1:], 1):
        parent, offset = model.parents[i], model.jointPlacements[i].translation
        step = offset if parent else offset - centre
        out[i] = out[parent] + np.linalg.norm(step) + slides[joint.idx_v : joint.idx_v + joint.nv].sum()
    away = out[bodies.joints] + np.linalg.norm(bodies.centres, axis=1) + bodies.radii
    return centre, float(away[bodies.joints > 0].max())


KNOWN_TO = 0.01  # accuracy of the times until which, and from which on, a place is free [s], above 0


def find_free_until(problem: Problem, z: LocalPoint) -> tuple[float, Verdict | None]:
    """Find until when a robot may stand at local coordinates (nv,) from time 0 on [s]; infinite if always.

    Returns:
        The time, and the refusal of what comes after it; None if nothing comes.
    """
    end = problem.scene.end
    if end <= 0.0:
        return math.inf, None
    verdict = _stands(problem, z, 0.0, end)
    if verdict.free or verdict.free_until is None or verdict.parameter is None:
        return math.inf, None
    first, last = verdict.free_until[1] * end, verdict.parameter * end
    while last - first > KNOWN_TO and not problem.deadline.expired():
        middle = 0.5 * (first + last)
        if _stands(problem, z, first, middle).free:
            first = middle
        else:
            last = middle
    return first, verdict


def find_free_from(problem: Problem, z: LocalPoint) -> float:
    """Find from when on a robot may stand for good at a point (nv,) that is free once all obstacles rest [s]."""
    last = max(problem.scene.end, 0.0)
    if last <= 0.0 or _stands(problem, z, 0.0, last).free:
        return 0.0
    first = 0.0
    while last - first > KNOWN_TO and not problem.deadline.expired():
        middle = 0.5 * (first + last)
        if _stands(problem, z, middle, problem.scene.end).free:
            last = middle
        else:
            first = middle
    return last


def _stands(problem: Problem, z: LocalPoint, begin: float, end: float) -> Verdict:
    verdict = certify_moving(
        problem.world,
        np.repeat(z[None, None], 4, axis=1),
        np.array([begin, end]),
        problem.min_clearance,
        deadline=problem.deadline,
    )
    problem.counters.collision_checks += verdict.evaluations
    return verdict
