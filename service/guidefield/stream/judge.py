"""The judge of commits: limits by a kernel of streams, all else by the proof that plans have."""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from guidefield.collision.solids import Solid
from guidefield.collision.world import World
from guidefield.kernels.prove.kept_distance import LOG_ROWS
from guidefield.kernels.prove.search import DEEPEST, INTERVAL, LOG_ENDS, prove_along
from guidefield.kernels.prove.tables import (
    ANSWER,
    CULPRIT,
    END,
    ERROR,
    FREE,
    KINDS,
    MARGIN,
    PLACE,
    REASON,
    RESOLUTION,
    SEGMENTS,
    UNDECIDED,
    VERDICT,
    BezierCurve,
    MovingObstacles,
    MovingRobot,
    ObstacleBodies,
)
from guidefield.kernels.stream.judge import bound_travel, broken_limit
from guidefield.planner.task.motion_limits import CartesianLimit
from guidefield.prove.search import EVERY_KIND, RESOLUTION_FLOOR, TOLERANCE
from guidefield.prove.tables import ARITHMETIC, body_pairs, robot_bodies, rounding_of
from guidefield.robot.group.kinematics import lent_data
from guidefield.stream.commit import STANDING, Commit, JointBounds
from guidefield.stream.settings import STREAM
from guidefield.stream.shapes import read_only_views, solid_parts

UNHALVED = 1e12  # an accuracy that any bound has: if that is within a limit, no closer one is searched for


class CommitReason(enum.Enum):
    """The judge's answer about a commit."""

    FREE = "free"
    LIMITS = "limits"
    OWN = "own"
    OBSTACLE = "obstacle"
    UNDECIDED = "undecided"


@dataclass(frozen=True)
class CommitVerdict:
    """The judge's answer about a commit, with the place of a refusal."""

    reason: CommitReason
    evaluations: int
    pair: int  # index of the pair, the robot's own first; of a limit the coordinate; -1: none is known
    time: float  # the time of the refusal, by the client's clock [s]

    @property
    def free(self) -> bool:
        """Whether the commit is proven."""
        return self.reason is CommitReason.FREE


class ClosedSurface(NamedTuple):
    """A closed surface, inside of which the robot touches nothing."""

    obstacle: int
    solid: Solid
    pose: np.ndarray | None  # its pose at rest, shape (3, 4) [m]; None of one that moves


class SeenObstacles(NamedTuple):
    """The obstacles of a stream as the proof reads them."""

    bodies: ObstacleBodies
    movers: MovingObstacles  # the motion of those that were declared
    reserved: MovingObstacles  # the same with larger margins: by what they may cover in the reserved time
    left_out: np.ndarray  # pairs with obstacles that may touch, as `PairTable` has them, shape (k,)
    closed: tuple[ClosedSurface, ...]
    error: float  # largest error of distances from them [m]


class Judge:
    """A judge with its memory; not for two threads.

    Args:
        keep: Distance to keep from obstacles [m].
        tolerances: Largest deviation of the robot from its piece, by coordinate, shape (nv,) [rad or m].
        in_space: Limits of speed in space.
    """

    def __init__(
        self,
        world: World,
        bounds: JointBounds,
        keep: float,
        tolerances: np.ndarray,
        in_space: Sequence[CartesianLimit] = (),
    ) -> None:
        self._in_space = tuple(in_space)
        roots, parts, self._inside = solid_parts(world.group)
        self._robot = read_only_views(robot_bodies(world)._replace(roots=roots, parts=parts, anchor=np.zeros(3)))
        self._pairs, self._group, self._limits = body_pairs(world), world.group, bounds.columns
        self._tolerances, self._exact = np.array(tolerances, float), np.zeros(len(tolerances))
        extent = float((np.abs(self._robot.centres).max(axis=1) + self._robot.radii).max(initial=0.0))
        self._error = rounding_of(parts) + ARITHMETIC * (1.0 + extent)
        self._data, self._keep = lent_data(world.group, self), keep
        self._waiting = np.zeros((1 + 3 * DEEPEST, INTERVAL))
        self._none = np.empty((0, ANSWER)), np.empty(0), np.zeros(LOG_ROWS), np.empty((0, LOG_ENDS))

    def judge(
        self, commit: Commit, seen: SeenObstacles, most: int, *, reserved: bool = False, since: float | None = None
    ) -> CommitVerdict:
        """Judge a commit among obstacles.

        Args:
            most: Largest number of segments that are judged.
            since: Begin of the judged part [s]; None: its beginning.
        """
        stops = commit.stops - commit.begins
        coordinate = broken_limit(commit.phases, commit.counts, commit.start, self._limits, stops)
        if coordinate >= 0:
            return CommitVerdict(CommitReason.LIMITS, 0, coordinate, commit.begins)
        if self.speed_share(commit) > 1.0:
            return CommitVerdict(CommitReason.LIMITS, 0, -1, commit.begins)
        moving = self._moving(commit, seen, self._tolerances, seen.reserved if reserved else seen.movers)
        begin = 0.0 if since is None else min(max(0.0, since - commit.begins), stops)
        verdict = np.zeros(VERDICT)
        verdict[[KINDS, MARGIN, ERROR, END]] = EVERY_KIND, self._keep, self._error + seen.error, np.inf
        verdict[RESOLUTION] = RESOLUTION_FLOOR * self._group.size
        # most refusals are at the end, where obstacles may have come closest: that is examined first
        count = self._search(moving, stops, stops + STANDING, most, verdict)
        if verdict[REASON] == FREE and stops > begin:
            count = self._search(moving, begin, stops, most, verdict)
        looked, pair, reason = int(verdict[SEGMENTS]), int(verdict[CULPRIT]), int(verdict[REASON])
        time = min(commit.begins + float(verdict[PLACE]), commit.stops)
        if reason == FREE and count > 0:
            return CommitVerdict(CommitReason.UNDECIDED, looked, -1, commit.stops)
        if reason == FREE:
            pair = self._find_enclosure(commit, seen)
            judgement, time = (CommitReason.FREE, commit.begins) if pair < 0 else (CommitReason.OBSTACLE, commit.stops)
        elif reason == UNDECIDED:
            judgement = CommitReason.UNDECIDED
        else:
            judgement = CommitReason.OWN if pair < len(self._pairs.own) else CommitReason.OBSTACLE
        return CommitVerdict(judgement, looked, pair, time)

    def speed_share(self, commit: Commit) -> float:
        """The largest share of a limit of speed in space that a commit reaches, by a bound; 0 where there is none."""
        if not self._in_space:
            return 0.0
        motion, shares = commit.polynomials, []
        for one in self._in_space:
            bound = one.measure(motion, UNHALVED)[0].bound
            if bound > STREAM.in_space * one.speed:
                bound = one.measure(motion)[0].bound
            shares.append(bound / one.speed)
        return max(shares)

    def bound_travel(self, commit: Commit, seen: SeenObstacles, since: float, until: float, parts: int = 16) -> float:
        """Bound how far any point of the robot moves between two times of a commit, tolerances included [m]."""
        begin = max(0.0, since - commit.begins)
        moving, exact = (self._moving(commit, seen, off, seen.movers) for off in (self._tolerances, self._exact))
        return float(bound_travel(moving, exact.curve, begin, max(begin, until - commit.begins), parts))

    def _moving(
        self, commit: Commit, seen: SeenObstacles, tolerances: np.ndarray, movers: MovingObstacles
    ) -> MovingRobot:
        times, controls = commit.curve
        tube = np.tile(tolerances, (len(controls), 1))
        curve = read_only_views(BezierCurve(times, commit.begins + times, controls, tube))
        return MovingRobot(self._robot, seen.bodies, movers, self._pairs._replace(left_out=seen.left_out), curve)

    def _search(self, moving: MovingRobot, begin: float, end: float, most: int, verdict: np.ndarray) -> int:
        self._waiting[0] = begin, end
        questions, empty, log, segments = self._none
        return int(
            prove_along(
                moving, TOLERANCE, empty, 1, most, end - begin, 0.0, questions, verdict, self._waiting, 1, empty, log,
                segments,
            )
        )  # fmt: skip

    def _find_enclosure(self, commit: Commit, seen: SeenObstacles) -> int:
        """Return a pair whose body is inside of a closed surface in the end, and so all along; -1: there is none."""
        if not seen.closed:
            return -1
        moving, count = self._pairs.moving, len(seen.bodies.roots)
        pin.forwardKinematics(self._group.model, self._data, self._group.expand_from_chart(commit.ends))
        places = [self._data.oMi[joint] for joint in self._robot.carriers[moving].tolist()]
        points = np.array([place.act(point) for place, point in zip(places, self._inside[moving], strict=True)])
        for obstacle, solid, at_rest in seen.closed:
            pose = at_rest
            if pose is None:
                row = seen.movers.begins[seen.bodies.movers[obstacle]]
                pose = seen.movers.poses[row].reshape(3, 4).copy()
                pose[:, 3] += (commit.stops - seen.movers.times[row]) * seen.movers.twists[row, :3]
            mixed = np.arange(len(moving)) * count + obstacle
            meets = np.flatnonzero(~np.isin(mixed, seen.left_out))
            local = (points[meets] - pose[:, 3]) @ pose[:, :3]
            if solid.contains_any(local):
                inside = [solid.contains_any(point[None]) for point in local]
                return len(self._pairs.own) + int(mixed[meets[np.argmax(inside)]])
        return -1
