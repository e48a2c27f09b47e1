"""The certificate among obstacles that move: Coal's judgement of a motion in time, between its samples too.

What rests is judged by the certificate of curves, whatever their timing. For what moves, segments of time are halved
until at their middles every robot body keeps more from every moving obstacle than both can lose within the segment:
the robot by `MotionBound`, the obstacle by its largest speed; a half-space, which is endless, by the largest speed at
which it passes where the robot is. Of many that move, boxes that they stay in tell which the robot is far from all
along a piece. Balls and boxes about bodies tell most other pairs apart before Coal is asked.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from dataclasses import dataclass
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from guidefield.collision.coal_transforms import transform
from guidefield.collision.robot_ball import robot_ball
from guidefield.deadline import UNLIMITED, Deadline
from guidefield.geometry.met import as_met
from guidefield.prove.certificate import certify
from guidefield.prove.settings import CERTIFICATE, with_coal_error
from guidefield.prove.timed_world import TimedWorld
from guidefield.prove.verdict import Reason, Verdict, first_refused
from guidefield.read_only import ReadOnly
from guidefield.robot.model.spaces import ChartCurves, ChartPoint, ChartPoints
from guidefield.scene.swept import motion_of

ASKED_EVERY = 16
"""After so many evaluations it is asked whether the judgement is to end."""

MANY_PAIRS, MANY_FACES = 400, 10_000
"""Where more pairs are left, or an obstacle has more triangles or points, it is asked at each evaluation."""

MANY = 16
"""Where more obstacles move, those that are far all along a piece of a motion are left out at once."""


def certify_timed(
    worlds: TimedWorld,
    pieces: ChartCurves,
    times: np.ndarray,
    min_clearance: float = 0.0,
    floor: float = CERTIFICATE.timed_floor,
    deadline: Deadline = UNLIMITED,
) -> Verdict:
    """Judge a motion in time; see `certify`.

    Args:
        worlds: The robot among obstacles.
        pieces: Bezier control points of each piece in the group's chart, shape (m, k, nv) [rad or m].
        times: When they begin and the last one ends, shape (m + 1,) [s].
        min_clearance: What robot and obstacles must keep apart [m].
        floor: See `CERTIFICATE.timed_floor` [m].
        deadline: Ends the judgement.
    """
    verdict = certify(worlds.resting, pieces, min_clearance, deadline=deadline)
    moving = certify_moving(worlds, pieces, times, min_clearance, floor, deadline)
    return first_refused(verdict, moving)


def certify_moving(
    worlds: TimedWorld,
    pieces: ChartCurves,
    times: np.ndarray,
    min_clearance: float = 0.0,
    floor: float = CERTIFICATE.timed_floor,
    deadline: Deadline = UNLIMITED,
) -> Verdict:
    """`certify_timed` for the obstacles that move alone.

    Args:
        worlds: As there.
        pieces: Control points of Bezier curves in the group's chart, shape (n, k, nv); none: it is free.
        times: When each piece begins, and the last ends, shape (n + 1,) [s].
        min_clearance: What to keep from the obstacles [m].
        floor: As there.
        deadline: As there.
    """
    pieces = np.asarray(pieces, float)
    if not len(pieces):  # nothing goes on from where it is known to be free
        return Verdict(Reason.FREE, 0)
    judge = _Judge(worlds, pieces, min_clearance, floor, deadline)
    for index, piece in enumerate(pieces):
        refusal = judge.refusal(
            _TimedSegment(index, piece, 0.0, 1.0, float(times[index]), float(times[index + 1]), judge.pairs_near(piece))
        )
        if refusal is not None:
            return refusal
    return Verdict(Reason.FREE, judge.evaluations)


def _about_robot(worlds: TimedWorld, pieces: ChartCurves) -> tuple[np.ndarray, float]:
    """A ball that the robot stays in along a motion; see `robot_ball`. It is asked for where an obstacle is endless."""
    if not worlds.movers.endless:
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
    pairs: np.ndarray

    def halves(self, pairs: np.ndarray) -> tuple[_TimedSegment, _TimedSegment]:
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
        deadline: Deadline,
    ) -> None:
        self.worlds = worlds
        self.deadline = deadline
        self.kept = min_clearance
        self.floor = floor
        self.evaluations = 0
        self._movers = worlds.movers
        self._large = any(one.faces > MANY_FACES for one in worlds.movers.obstacles)
        self._placed: tuple[float, dict[int, Any]] = (0.0, {})
        about = _about_robot(worlds, pieces)
        self._speeds = [
            speeds if ball is not None else motion_of(one).passing(*about)[1:-1].tolist()
            for one, ball, speeds in zip(self._movers.obstacles, self._movers.balls, self._movers.speeds, strict=True)
        ]

    def pairs_near(self, piece: ChartPoints) -> np.ndarray:
        """The pairs of which the obstacle isn't far from the robot all along a piece (k, nv); ascending, shape (n,)."""
        worlds, movers = self.worlds, self._movers
        if len(movers.obstacles) <= MANY:
            return np.arange(len(worlds.pairs))
        centre, radius = robot_ball(worlds.moving, piece.min(axis=0), piece.max(axis=0))
        near = movers.near(centre, radius, float(with_coal_error(np.array([self.kept]))[0]))
        return np.flatnonzero(near[worlds.mover_of])

    def refusal(self, segment: _TimedSegment) -> Verdict | None:
        """Why a segment is refused, or None; the first half is judged before the second."""
        pairs = segment.pairs
        if (self.evaluations % ASKED_EVERY == 0 or len(pairs) > MANY_PAIRS or self._large) and self.deadline.expired():
            at, z = segment.start, segment.control[0]
            return Verdict(Reason.STOPPED, self.evaluations, segment.piece, at, (segment.piece, at), None, z)
        low, high = segment.control.min(axis=0), segment.control.max(axis=0)
        time, half = 0.5 * (segment.since + segment.until), 0.5 * (segment.until - segment.since)
        bounds = self._bounds(pairs, 0.5 * (low + high), 0.5 * (high - low))
        bounds += half * self._speeds_between(pairs, segment.since, segment.until)
        margins = with_coal_error(self.kept + bounds)
        near = self._near(pairs, time, margins)
        left = np.array([k for k in near if self._within(int(pairs[k]), time, margins[k])], int)
        if not len(left):
            return None
        first, second = segment.halves(pairs[left])
        refused = self._refused_at(second, (segment.piece, segment.start), bounds[left])
        if refused is not None:
            return refused
        return self.refusal(first) or self.refusal(second)

    def _speeds_between(self, pairs: np.ndarray, since: float, until: float) -> np.ndarray:
        """How fast the obstacle of each of some pairs loses distance at most between two times [m/s]."""
        movers, of_each = np.unique(self.worlds.mover_of[pairs], return_inverse=True)
        found = []
        for mover in movers.tolist():
            times, speeds = self._movers.times[mover], self._speeds[mover]
            first, last = bisect_right(times, since) - 1, bisect_left(times, until)
            found.append(max(speeds[max(first, 0) : last], default=0.0))
        of_pairs: np.ndarray = np.array(found)[of_each]
        return of_pairs

    def _bounds(self, pairs: np.ndarray, middle: ChartPoint, half_widths: ChartPoint) -> np.ndarray:
        """How much closer the robot alone brings some pairs within a box of the chart [m]; places it at its middle."""
        world = self.worlds.moving
        group = world.group
        self.evaluations += 1
        jacobian = pin.computeJointJacobians(world.model, world.data, group.expand_from_chart(middle))
        world.place_bodies()
        centres = world.bodies.centres_in_world(world.joint_placements[None])
        _, mixed = world.motion_bound.at(jacobian.reshape(6, -1)[None], centres, half_widths[None])
        bounds: np.ndarray = mixed[0][self.worlds.body_of[pairs]]
        return bounds

    def _placement(self, mover: int, time: float) -> Any:
        """Where an obstacle that moves is at a time [s], a pinocchio.SE3."""
        if self._placed[0] != time:
            self._placed = time, {}
        known = self._placed[1]
        if mover not in known:
            known[mover] = self._movers.obstacles[mover].placement_at(time)
        return known[mover]

    def _near(self, pairs: np.ndarray, time: float, margins: np.ndarray) -> list[int]:
        """Which of some pairs may be within margins (n,) where the robot was placed last, at a time: their indices.

        The balls about parts of a body are farther from the box about an obstacle than that, for all others.
        """
        bodies, known = self.worlds.moving.bodies, self._movers
        if not len(pairs):
            return []
        movers, body = self.worlds.mover_of[pairs], self.worlds.body_of[pairs]
        some, of_each = np.unique(movers, return_inverse=True)
        placements = [self._placement(mover, time) for mover in some.tolist()]
        turns, places = (
            np.array([one.rotation for one in placements]),
            np.array([one.translation for one in placements]),
        )
        joints = self.worlds.moving.joint_placements[None]
        centres = bodies.part_centres_in_world(joints, np.zeros(len(pairs), int), body)
        local = (centres - places[of_each][:, None]) @ turns[of_each]
        low, high = known.boxes[movers, :1], known.boxes[movers, 1:]
        beyond = np.maximum(np.maximum(low - local, local - high), 0.0)
        rounding = bodies.part_radii[body] + known.rounded[movers]
        gaps = np.sqrt(np.einsum("mpi,mpi->mp", beyond, beyond).min(axis=1)) - rounding
        near: list[int] = np.flatnonzero(gaps <= margins).tolist()
        return near

    def _within(self, k: int, time: float, margin: float) -> bool:
        """Whether a pair comes within a margin (>= 0) of each other where the robot was placed last, at a time.

        Coal answers for no margin below 0 where a body is a mesh. Of a rounded obstacle it sees the inside only.
        """
        world, mover, body = self.worlds.moving, int(self.worlds.mover_of[k]), int(self.worlds.body_of[k])
        obstacle = self._movers.obstacles[mover]
        if obstacle.facets is not None and obstacle.facets.patches is not None:  # one tree of all takes seconds
            other = world.pairs.links + int(self._movers.indices[mover])
            world.move(other, self._placement(mover, time))
            return world.penetration_of(body, other, margin) is not None
        shape, other = as_met(world.exact.shape(body), obstacle.shape)
        request, result = coal.CollisionRequest(), coal.CollisionResult()
        request.security_margin = margin + obstacle.rounding
        here, there = transform(world.placement(body)), transform(self._placement(mover, time))
        return bool(coal.collide(shape, here, other, there, request, result))

    def _refused_at(self, rest: _TimedSegment, free_until: tuple[int, float], bounds: np.ndarray) -> Verdict | None:
        """Why the motion is refused where its rest begins: it touches there, or the pairs left can't move any less.

        Args:
            rest: The rest, of the pairs that are left.
            free_until: Up to where it is free.
            bounds: How much closer each of them can come, shape (n,) [m].
        """
        self._bounds(rest.pairs[:0], rest.control[0], np.zeros_like(rest.control[0]))
        found = self._touching(rest.since, rest.pairs.tolist())
        if found is None:
            undecided = rest.pairs[bounds <= self.floor]
            if not len(undecided):
                return None
            found = Reason.UNDECIDED, int(undecided[0])
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
