"""Obstacles that move, held where they are at some moments: for lanes by slices of time, and for ways among them."""

from __future__ import annotations

import dataclasses
import math
from bisect import bisect_left, bisect_right
from collections.abc import Mapping, Sequence

import msgspec
import numpy as np
import pinocchio as pin

from guidefield.collision.lanes.lanes import BatchCollision
from guidefield.collision.pairs import Pairs
from guidefield.collision.world import World
from guidefield.geometry.placements import transform_points
from guidefield.messages import scene as messages
from guidefield.planner.schedule.settings import SCHEDULE
from guidefield.planner.task.problem import Problem
from guidefield.prove.certificate import certify_moving
from guidefield.prove.verdict import Verdict
from guidefield.robot.model.size import MARGIN
from guidefield.robot.model.spaces import ChartPoint
from guidefield.scene import obstacle as obstacles
from guidefield.scene.cloud import covering
from guidefield.scene.content import count_of
from guidefield.scene.motion import posed
from guidefield.scene.movers import MovingBall, motion_of, movers
from guidefield.scene.obstacle import Obstacle

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
    return obstacles.build(posed(one.message, one.motion.at(time)), 0)


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
        self._kept: dict[int, tuple[BatchCollision, float]] = {}

    def touching(self, index: int, zs: np.ndarray) -> np.ndarray:
        """Which chart points (n, nv) may touch in a slice, by its index; shape (n,), bool."""
        index = min(index, self.resting_from)
        if index not in self._kept:
            while len(self._kept) >= SCHEDULE.kept_slices:
                self._kept.pop(next(iter(self._kept)))
            self._kept[index] = self._slice(index)
        lanes, clearance = self._kept[index]
        self._problem.counters.collision_checks += len(zs)
        return lanes.touching(zs, clearance)

    def _slice(self, index: int) -> tuple[BatchCollision, float]:
        kept, begin, end = self._problem.min_clearance, index * self.length, (index + 1) * self.length
        size = self._problem.group.size
        moments, moves = {}, 0.0
        for mover, ball in self._balls.items():
            way = 0.0 if index >= self.resting_from else 0.5 * self._speed(mover, ball, begin, end) * self.length
            copies = int(np.clip(math.ceil(way / (SCHEDULE.finest * size)), 1, SCHEDULE.most_copies))
            moments[mover] = (begin + (np.arange(copies) + 0.5) / copies * self.length).tolist()
            moves = max(moves, way / copies)
        if index < self.resting_from:
            kept += MARGIN * size + moves
        return BatchCollision.build(_world(self._problem, moments, np.empty((0, 2), np.int64))), kept

    def _speed(self, mover: int, ball: MovingBall | None, begin: float, end: float) -> float:
        """How fast an obstacle comes closer at most between two times; a half-space to where the robot gets [m/s]."""
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


KNOWN_TO = 0.01  # how exactly it is found until when, and from when on, a place is free [s]


def find_meeting(problem: Problem, z: ChartPoint) -> tuple[float, Verdict | None]:
    """Until when a robot may stand at a chart point (nv,) from time 0 on [s]; infinite if always.

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


def find_free_from(problem: Problem, z: ChartPoint) -> float:
    """From when on a robot may stand at a chart point (nv,) for good [s].

    It is free once all obstacles have come to rest.
    """
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


def stays_free(problem: Problem, z: ChartPoint, since: float) -> bool:
    """Whether a robot may stand at a chart point (nv,) from a time on [s] until all obstacles have come to rest."""
    return since >= problem.scene.end or _stands(problem, z, since, problem.scene.end).free


def _stands(problem: Problem, z: ChartPoint, begin: float, end: float) -> Verdict:
    verdict = certify_moving(
        problem.world,
        np.repeat(z[None, None], 4, axis=1),
        np.array([begin, end]),
        problem.min_clearance,
        deadline=problem.deadline,
    )
    problem.counters.collision_checks += verdict.evaluations
    return verdict
