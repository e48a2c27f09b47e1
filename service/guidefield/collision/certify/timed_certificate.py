"""The certificate among obstacles that move: Coal's judgement of a motion in time, between its samples too.

What rests is judged by the certificate of curves, whatever their timing. For what moves, segments of time are halved
until at their middles every robot body keeps more from every moving obstacle than both can lose within the segment:
the robot by `MotionBound`, the obstacle by its largest speed; a half-space, which is endless, by the largest speed at
which it passes where the robot is. Balls and boxes about them tell most pairs apart before Coal is asked.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from guidefield.collision.certify.certificate import certify
from guidefield.collision.certify.settings import CERTIFICATE, with_coal_error
from guidefield.collision.certify.verdict import Reason, Verdict, first_refused
from guidefield.collision.coal_transforms import transform
from guidefield.collision.robot_ball import robot_ball
from guidefield.collision.world import World
from guidefield.geometry.met import as_met
from guidefield.read_only import ReadOnly
from guidefield.robot.model.spaces import ChartCurves, ChartPoint, ChartPoints
from guidefield.scene.obstacle import Obstacle

ASKED_EVERY = 16
"""After so many evaluations it is asked whether the judgement is to end."""


@dataclass(frozen=True, eq=False)
class TimedWorld(ReadOnly):
    """A robot among obstacles of which some move.

    Attributes:
        resting: The robot among those that rest.
        moving: The robot among all, those that move where they are at first.
        pairs: Indices of `moving.pairs` that are of a robot body and an obstacle that moves.
        obstacles: The obstacle of each.
        balls: Centre (3,) in the frame of the obstacle's motion and radius of a ball about each; None about a
            half-space.
    """

    resting: World
    moving: World
    pairs: np.ndarray
    obstacles: tuple[Obstacle, ...]
    balls: tuple[tuple[np.ndarray, float] | None, ...]

    @classmethod
    def of(cls, resting: World, moving: World) -> TimedWorld:
        """From the two worlds."""
        if not moving.scene.moves:
            return cls(resting, moving, np.empty(0, np.int64), (), ())
        movers = np.flatnonzero([one.motion is not None for one in moving.scene.obstacles])
        pairs = moving.pairs.of_obstacles(movers)
        of = (moving.pairs.bodies(pairs)[:, 1] - moving.pairs.links).tolist()
        balls = {index: _ball(moving.scene.obstacles[index]) for index in movers.tolist()}
        obstacles = tuple(moving.scene.obstacles[index] for index in of)
        return cls(resting, moving, pairs, obstacles, tuple(balls[index] for index in of))


def certify_timed(
    worlds: TimedWorld,
    pieces: ChartCurves,
    times: np.ndarray,
    min_clearance: float = 0.0,
    floor: float = CERTIFICATE.timed_floor,
    stopped: Callable[[], object] = lambda: None,
) -> Verdict:
    """Judge a motion in time; see `certify`.

    Args:
        worlds: The robot among obstacles.
        pieces: Bezier control points of each piece in the group's chart, shape (m, k, nv) [rad or m].
        times: When they begin and the last one ends, shape (m + 1,) [s].
        min_clearance: What robot and obstacles must keep apart [m].
        floor: See `CERTIFICATE.timed_floor` [m].
        stopped: Asked now and then; anything true ends the judgement.
    """
    verdict = certify(worlds.resting, pieces, min_clearance, stopped=stopped)
    moving = certify_moving(worlds, pieces, times, min_clearance, floor, stopped)
    return first_refused(verdict, moving)


def certify_moving(
    worlds: TimedWorld,
    pieces: ChartCurves,
    times: np.ndarray,
    min_clearance: float = 0.0,
    floor: float = CERTIFICATE.timed_floor,
    stopped: Callable[[], object] = lambda: None,
) -> Verdict:
    """`certify_timed` for the obstacles that move alone.

    Args:
        worlds: As there.
        pieces: Control points of Bezier curves in the group's chart, shape (n, k, nv); none: it is free.
        times: When each piece begins, and the last ends, shape (n + 1,) [s].
        min_clearance: What to keep from the obstacles [m].
        floor: As there.
        stopped: As there.
    """
    pieces = np.asarray(pieces, float)
    if not len(pieces):  # nothing goes on from where it is known to be free
        return Verdict(Reason.FREE, 0)
    judge = _Judge(worlds, pieces, min_clearance, floor, stopped)
    for index, piece in enumerate(pieces):
        every = list(range(len(worlds.pairs)))
        refusal = judge.refusal(
            _TimedSegment(index, piece, 0.0, 1.0, float(times[index]), float(times[index + 1]), every)
        )
        if refusal is not None:
            return refusal
    return Verdict(Reason.FREE, judge.evaluations)


def _ball(obstacle: Obstacle) -> tuple[np.ndarray, float] | None:
    """A ball about an obstacle in the frame of its motion; None if it is endless."""
    assert obstacle.motion is not None, "only what moves is asked for"
    if obstacle.endless:
        return None
    low, high = obstacle.box
    middle = 0.5 * (low + high) if obstacle.cloud is not None else _middle(obstacle)
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    reach = [float(np.linalg.norm(obstacle.placement.act(low + c * (high - low)) - middle)) for c in corners]
    return np.asarray(obstacle.motion.placements[0].actInv(middle)), max(reach) + obstacle.rounding


def _middle(obstacle: Obstacle) -> np.ndarray:
    """The middle of the box about an obstacle along the world's axes, shape (3,) [m, world]."""
    vertices = obstacle.vertices
    middle: np.ndarray = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    return middle


def _largest_speeds(
    obstacle: Obstacle, ball: tuple[np.ndarray, float] | None, about_robot: tuple[np.ndarray, float]
) -> tuple[list[float], list[float]]:
    """When an obstacle is on its placements [s], and how fast it loses distance at most from each to the next."""
    motion = obstacle.motion
    assert motion is not None, "only what moves is judged here"
    speeds = motion.passing(*about_robot) if ball is None else motion.rates(*ball)[0]
    return motion.times.tolist(), speeds[1:-1].tolist()


def _about_robot(worlds: TimedWorld, pieces: ChartCurves) -> tuple[np.ndarray, float]:
    """A ball that the robot stays in along a motion; see `robot_ball`. It is asked for where an obstacle is endless."""
    if all(ball is not None for ball in worlds.balls):
        return np.zeros(3), 0.0
    return robot_ball(worlds.moving, pieces.min(axis=(0, 1)), pieces.max(axis=(0, 1)))


@dataclass(frozen=True, eq=False)
class _TimedSegment(ReadOnly):
    """A part of a piece: control points, parameters on the piece, times, and the pairs that are left."""

    piece: int
    control: ChartPoints
    start: float
    end: float
    since: float
    until: float
    pairs: list[int]

    def halves(self, pairs: list[int]) -> tuple[_TimedSegment, _TimedSegment]:
        """Both halves by de Casteljau's scheme, for some pairs."""
        row, first, second = self.control, [self.control[0]], [self.control[-1]]
        while len(row) > 1:
            row = 0.5 * (row[:-1] + row[1:])
            first.append(row[0])
            second.append(row[-1])
        parameter, time = 0.5 * (self.start + self.end), 0.5 * (self.since + self.until)
        return (
            _TimedSegment(self.piece, np.array(first), self.start, parameter, self.since, time, pairs),
            _TimedSegment(self.piece, np.array(second[::-1]), parameter, self.end, time, self.until, pairs),
        )


class _Judge:
    """One judgement, and how many configurations were judged."""

    def __init__(
        self,
        worlds: TimedWorld,
        pieces: ChartCurves,
        min_clearance: float,
        floor: float,
        stopped: Callable[[], object],
    ) -> None:
        self.worlds = worlds
        self.stopped = stopped
        self.kept = min_clearance
        self.floor = floor
        self.evaluations = 0
        movers = list({id(one): k for k, one in enumerate(worlds.obstacles)}.values())
        known = [id(worlds.obstacles[k]) for k in movers]
        self._mover_of = np.array([known.index(id(one)) for one in worlds.obstacles], int)
        self._body_of = worlds.moving.pairs.bodies(worlds.pairs)[:, 0]
        self._movers = [worlds.obstacles[k] for k in movers]
        self._boxes = np.array([one.box for one in self._movers]).reshape(-1, 2, 3)
        self._rounded = np.array([one.rounding for one in self._movers])
        self._placed: tuple[float, list[Any]] | None = None
        about_robot = _about_robot(worlds, pieces)
        self._speeds = [_largest_speeds(worlds.obstacles[k], worlds.balls[k], about_robot) for k in movers]

    def refusal(self, segment: _TimedSegment) -> Verdict | None:
        """Why a segment is refused, or None; the first half is judged before the second."""
        if self.evaluations % ASKED_EVERY == 0 and self.stopped():
            at, z = segment.start, segment.control[0]
            return Verdict(Reason.STOPPED, self.evaluations, segment.piece, at, (segment.piece, at), None, z)
        low, high = segment.control.min(axis=0), segment.control.max(axis=0)
        time, half = 0.5 * (segment.since + segment.until), 0.5 * (segment.until - segment.since)
        bounds = self._bounds(0.5 * (low + high), 0.5 * (high - low))
        bounds += half * self._speeds_between(segment.since, segment.until)
        margins = with_coal_error(self.kept + bounds)
        left = [k for k in self._near(segment.pairs, time, margins) if self._within(k, time, margins[k])]
        if not left:
            return None
        first, second = segment.halves(left)
        refused = self._refused_at(second, (segment.piece, segment.start), left, bounds)
        if refused is not None:
            return refused
        return self.refusal(first) or self.refusal(second)

    def _speeds_between(self, since: float, until: float) -> np.ndarray:
        """How fast each pair's obstacle loses distance at most between two times [m/s]."""
        found = []
        for times, speeds in self._speeds:
            first, last = bisect_right(times, since) - 1, bisect_left(times, until)
            found.append(max(speeds[max(first, 0) : last], default=0.0))
        of_pairs: np.ndarray = np.array(found)[self._mover_of]
        return of_pairs

    def _bounds(self, middle: ChartPoint, half_widths: ChartPoint) -> np.ndarray:
        """How much closer the robot alone brings each pair within a box of the chart [m]; places it at its middle."""
        world = self.worlds.moving
        group = world.group
        self.evaluations += 1
        jacobian = pin.computeJointJacobians(world.model, world.data, group.expand_from_chart(middle))
        world.place_bodies()
        centres = world.bodies.centres_in_world(world.joint_placements[None])
        _, mixed = world.motion_bound.at(jacobian.reshape(6, -1)[None], centres, half_widths[None])
        return np.array(mixed[0][self._body_of])

    def _placements(self, time: float) -> list[Any]:
        """Where the obstacles that move are at a time [s], pinocchio.SE3 each."""
        if self._placed is None or self._placed[0] != time:
            self._placed = time, [one.placement_at(time) for one in self._movers]
        return self._placed[1]

    def _near(self, pairs: list[int], time: float, margins: np.ndarray) -> list[int]:
        """Those of some pairs that may be within margins (n,) where the robot was placed last, at a time.

        The balls about parts of a body are farther from the box about an obstacle than that, for all others.
        """
        which, bodies = np.array(pairs, int), self.worlds.moving.bodies
        if not len(which):
            return []
        movers, body = self._mover_of[which], self._body_of[which]
        placements = self._placements(time)
        turns, places = (
            np.array([one.rotation for one in placements]),
            np.array([one.translation for one in placements]),
        )
        joints = self.worlds.moving.joint_placements[None]
        centres = bodies.part_centres_in_world(joints, np.zeros(len(which), int), body)
        local = (centres - places[movers][:, None]) @ turns[movers]
        low, high = self._boxes[movers, :1], self._boxes[movers, 1:]
        beyond = np.maximum(np.maximum(low - local, local - high), 0.0)
        rounding = bodies.part_radii[body] + self._rounded[movers]
        gaps = np.sqrt(np.einsum("mpi,mpi->mp", beyond, beyond).min(axis=1)) - rounding
        near: list[int] = which[gaps <= margins[which]].tolist()
        return near

    def _within(self, k: int, time: float, margin: float) -> bool:
        """Whether a pair comes within a margin (>= 0) of each other where the robot was placed last, at a time.

        Coal answers for no margin below 0 where a body is a mesh. Of a rounded obstacle it sees the inside only.
        """
        world, obstacle = self.worlds.moving, self.worlds.obstacles[k]
        body, mover = int(self._body_of[k]), int(self._mover_of[k])
        shape, other = as_met(world.exact.shape(body), obstacle.shape)
        request, result = coal.CollisionRequest(), coal.CollisionResult()
        request.security_margin = margin + obstacle.rounding
        here, there = transform(world.placement(body)), transform(self._placements(time)[mover])
        return bool(coal.collide(shape, here, other, there, request, result))

    def _refused_at(
        self, rest: _TimedSegment, free_until: tuple[int, float], left: list[int], bounds: np.ndarray
    ) -> Verdict | None:
        """Why the motion is refused where its rest begins: it touches there, or the pairs left can't move any less."""
        self._bounds(rest.control[0], np.zeros_like(rest.control[0]))
        found = self._touching(rest.since, left)
        if found is None:
            undecided = [k for k in left if bounds[k] <= self.floor]
            if not undecided:
                return None
            found = Reason.UNDECIDED, undecided[0]
        names = self.worlds.moving.pair_names(int(self.worlds.pairs[found[1]]))
        return Verdict(found[0], self.evaluations, rest.piece, rest.start, free_until, names, rest.control[0])

    def _touching(self, time: float, pairs: list[int]) -> tuple[Reason, int] | None:
        """What is wrong where the robot was placed last, contact or too close, and with which pair; or None."""
        for k in pairs:
            if self._within(k, time, 0.0):
                return Reason.CONTACT, k
        for k in pairs:
            if self.kept > 0.0 and self._within(k, time, self.kept):
                return Reason.TOO_CLOSE, k
        return None
