"""Commits, a piece of constant jerk and the hardest braking after it, and their judge: limits, and plans' proof.

The judge proves the curve of a commit, clients get its `trajectory`: both have to be the same motion. Names of a
`Commit`'s fields are in the files of journals, as those of `state.py` are.
"""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, cast

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
from guidefield.kernels.stream.phases import MOST_PHASES, bound_travel, broken_limit, find_states, piece_and_braking
from guidefield.kernels.timing.carried_rates import MotionPolynomials
from guidefield.messages.streams import PieceTrajectory
from guidefield.planner.task.motion_limits import CartesianLimit
from guidefield.prove.search import EVERY_KIND, RESOLUTION_FLOOR, TOLERANCE
from guidefield.prove.tables import ARITHMETIC, body_pairs, robot_bodies, rounding_of
from guidefield.read_only import ReadOnly, read_only
from guidefield.robot.group.kinematics import lent_data
from guidefield.robot.model.joints import LocalPoint
from guidefield.stream.settings import STREAM
from guidefield.stream.shapes import read_only_views, solid_parts

SAME_TIME = 1e-9
"""Knots that are closer than this become one in what clients get [s]; so do those within `ROUNDED`.

More than rounding may not become one: clients would execute another motion than the judge has proven.
"""
ROUNDED = 16  # steps of a double at the client's clock
STANDING = 1e-6  # duration of standing that the judge checks, after a stop or all along [s]: more refuses more


@dataclass(frozen=True, eq=False)
class Commit(ReadOnly):
    """A motion that ends in a stop."""

    number: int
    begins: float  # its begin, by the client's clock [s]
    brakes: float  # begin of its braking [s]
    stops: float  # time from which the robot stands [s]
    start: np.ndarray  # value, velocity and acceleration at its beginning, shape (nv, 3)
    # of each coordinate, shape (nv, k, 5), times from `begins`, as in kernels/stream/phases.py
    phases: np.ndarray
    counts: np.ndarray  # number of phases of each coordinate, shape (nv,)
    ends: LocalPoint  # configuration in which the robot stands in the end, shape (nv,)
    follows: int = 0  # number of the commit that it follows
    goal: int = 0  # number of its goal
    at_goal: bool = False  # whether it ends there

    @classmethod
    def standing(cls, z: LocalPoint, time: float, number: int = 0, goal: int = 0) -> Commit:
        """Standing at coordinates z, shape (nv,), since a time [s]."""
        phases = np.zeros((len(z), MOST_PHASES, 5))
        phases[:, 0, 1] = z
        start = np.column_stack([z, np.zeros((len(z), 2))])
        return cls(number, time, time, time, start, phases, np.ones(len(z), np.int64), z.copy(), number, goal)

    def state(self, time: float) -> np.ndarray:
        """Value, velocity, acceleration and jerk at a time [s], shape (nv, 4)."""
        state: np.ndarray = self._states(np.array([max(0.0, time - self.begins)]))[0]
        return state

    def _states(self, since: np.ndarray) -> np.ndarray:
        states = np.empty((len(since), len(self.counts), 4))
        find_states(self.phases, self.counts, since, states)
        return states

    @cached_property
    def knots(self) -> np.ndarray:
        """Times from the beginning between which every jerk is constant, shape (k,), ascending; 0 and its end among."""
        held = np.arange(self.phases.shape[1]) < self.counts[:, None]
        return np.unique(np.concatenate([self.phases[:, :, 0][held], [0.0, self.stops - self.begins]]))

    @property
    def _bounds_of_pieces(self) -> np.ndarray:
        """The knots; a commit that stands has a piece, too."""
        return self.knots if len(self.knots) > 1 else np.array([0.0, STANDING])

    @property
    def polynomials(self) -> MotionPolynomials:
        """The motion by powers of the time since a piece begins; times from its beginning on."""
        times = self._bounds_of_pieces.copy()
        powers = np.ascontiguousarray((self._states(times[:-1]) / np.array([1.0, 1.0, 2.0, 6.0])).swapaxes(1, 2))
        read_only(times, powers)
        return MotionPolynomials(times, powers)

    @cached_property
    def curve(self) -> tuple[np.ndarray, np.ndarray]:
        """The motion as Bezier curves: knots (k + 1,) and control points (k, 4, nv); one that stands has a piece, too.

        After its end it stands.
        """
        times = self._bounds_of_pieces
        states, spans = self._states(times), np.diff(times)[:, None]
        q, v, a = (states[:-1, :, k] for k in range(3))
        inner = q + v * spans / 3.0, q + spans * (2.0 * v / 3.0 + spans * a / 6.0)
        return times, np.ascontiguousarray(np.stack([q, *inner, states[1:, :, 0]], axis=1))

    def trajectory(self) -> PieceTrajectory:
        """The motion by knots between which every jerk is constant."""
        begins = self.knots
        apart, last = max(SAME_TIME, ROUNDED * float(np.spacing(abs(self.stops)))), begins[-1]
        begins = begins[np.concatenate([[True], np.diff(begins) > apart])]
        begins[-1] = last  # the motion ends at rest, and not a moment before
        times = self.begins + begins
        states = self._states(times - self.begins)  # where it is at the reported times: they are rounded
        states[0, :, :3], states[-1, :, 0], states[-1, :, 1:3] = self.start, self.ends, 0.0
        return PieceTrajectory(
            times=times.tolist(),
            positions=states[:, :, 0].tolist(),
            velocities=states[:, :, 1].tolist(),
            accelerations=states[:, :, 2].tolist(),
        )


def join_commits(commits: Sequence[Commit]) -> Commit:
    """The motion of several commits: each up to the begin of the next one, and all of the last one."""
    first, last = commits[0], commits[-1]
    if first is last:
        return first
    lists: list[list[np.ndarray]] = [[] for _ in first.counts]
    for at, one in enumerate(commits):
        until = commits[at + 1].begins if one is not last else np.inf
        for k, count in enumerate(one.counts.tolist()):
            rows = one.phases[k, :count].copy()
            rows = rows[one.begins + rows[:, 0] < until]
            rows[:, 0] += one.begins - first.begins
            lists[k].append(rows)
    joined = [np.concatenate(rows) for rows in lists]
    phases = np.zeros((len(joined), max(len(rows) for rows in joined), 5))
    for k, rows in enumerate(joined):
        phases[k, : len(rows)] = rows
    counts = np.array([len(rows) for rows in joined], np.int64)
    return Commit(
        last.number, first.begins, last.brakes, last.stops, first.start, phases, counts, last.ends, first.follows,
        last.goal, last.at_goal,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class JointBounds(ReadOnly):
    """The limits of every commit."""

    lower: np.ndarray  # least values, shape (nv,) [rad or m]
    upper: np.ndarray  # largest values, shape (nv,)
    rates: np.ndarray  # velocity, acceleration and jerk of each coordinate, shape (nv, 3)

    @property
    def columns(self) -> np.ndarray:
        """All limits as `broken_limit` takes them, shape (nv, 5)."""
        return np.column_stack([self.lower, self.upper, self.rates])


def plan_commit(
    state: np.ndarray,
    velocities: np.ndarray,
    goals: np.ndarray,
    bounds: JointBounds,
    begins: float,
    piece: float,
    within: float,
) -> Commit:
    """The commit of a piece from a state (nv, 3) towards velocities (nv,); it has no number yet.

    Coordinates aren't led beyond goals (nv,), which may be infinite. The piece has a begin and a duration [s]; `within`
    is the share of limits of rates, and the distance from those of position, that is left for rounding.
    """
    count = len(velocities)
    phases, counts, ends = np.zeros((count, MOST_PHASES, 5)), np.zeros(count, np.int64), np.zeros(count)
    state = np.ascontiguousarray(state[:, :3])
    room = np.minimum(within, 0.1 * (bounds.upper - bounds.lower))
    stops = piece_and_braking(
        state, velocities, goals, bounds.lower + room, bounds.upper - room, piece, bounds.rates * (1.0 - within),
        phases, counts, ends,
    )  # fmt: skip
    return Commit(-1, begins, begins + piece, begins + max(stops, piece), state, phases, counts, cast(LocalPoint, ends))


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
        """True if the commit is proven."""
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
    reserved: MovingObstacles  # the same with margins larger by what they may cover in `STREAM.reserve`
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
            most: Largest number of segments to check.
            reserved: Whether obstacles have the margins of `SeenObstacles.reserved`.
            since: Begin of the part to check [s]; None: its beginning.
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
        # most refusals are at the end, where obstacles may have come closest: it is examined, and reported, first
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
        pin.forwardKinematics(self._group.model, self._data, self._group.expand_from_local(commit.ends))
        places = [self._data.oMi[joint] for joint in self._robot.parent_joints[moving].tolist()]
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
