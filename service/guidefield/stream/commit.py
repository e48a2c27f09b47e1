"""Commits: a piece of constant jerk and the hardest braking after it, as one motion to a stop."""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from guidefield.kernels.collide.gjk_simplex import SIMPLEX
from guidefield.kernels.kinematics.forward_kinematics import joint_places
from guidefield.kernels.stream import judge
from guidefield.kernels.stream.judge import DEEPEST, MOST_NODES, JudgedPlaces, JudgedRobot, JudgedShapes, JudgeMemory
from guidefield.kernels.stream.way import MOST_PHASES, piece_and_braking
from guidefield.messages.streams import PieceTrajectory
from guidefield.read_only import ReadOnly
from guidefield.robot.model.spaces import ChartPoint

SAME_TIME = 1e-9  # knots that are closer are one [s]; see `ROUNDED`
ROUNDED = 16  # nor are two of them closer than so many steps of a double at the client's clock


@dataclass(frozen=True, eq=False)
class Commit(ReadOnly):
    """A motion that ends in a stop."""

    number: int
    begins: float  # when it begins, by the client's clock [s]
    brakes: float  # when its braking begins [s]
    stops: float  # when the robot stands [s]
    start: np.ndarray  # value, velocity and acceleration at its beginning, shape (nv, 3)
    phases: np.ndarray  # of each coordinate, shape (nv, k, 5), times from `begins`, as `profiles` has them
    counts: np.ndarray  # how many each has, shape (nv,)
    ends: ChartPoint  # where the robot stands in the end, shape (nv,)
    follows: int = 0
    goal: int = 0
    at_goal: bool = False

    @classmethod
    def standing(cls, z: ChartPoint, time: float, number: int = 0, goal: int = 0) -> Commit:
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
        """The same at times from the beginning (t,), shape (t, nv, 4)."""
        rows = np.arange(self.phases.shape[1])
        begun = (self.phases[:, :, 0] <= since[:, None, None]) & (rows < self.counts[:, None])
        chosen = self.phases[np.arange(len(self.counts)), begun.sum(axis=2) - 1]
        begin, q, v, a, j = np.moveaxis(chosen, 2, 0)
        s = since[:, None] - begin
        values = q + s * (v + s * (0.5 * a + s * j / 6.0))
        return np.stack([values, v + s * (a + 0.5 * s * j), a + s * j, j], axis=2)

    def trajectory(self) -> PieceTrajectory:
        """The motion by knots between which every jerk is constant."""
        held = np.arange(self.phases.shape[1]) < self.counts[:, None]
        begins = np.unique(np.concatenate([self.phases[:, :, 0][held], [0.0, self.stops - self.begins]]))
        apart, last = max(SAME_TIME, ROUNDED * float(np.spacing(abs(self.stops)))), begins[-1]
        begins = begins[np.concatenate([[True], np.diff(begins) > apart])]
        begins[-1] = last  # the motion ends at rest, and not a moment before
        times = self.begins + begins
        states = self._states(times - self.begins)  # where it is at the times as they are told: they are rounded
        states[0, :, :3], states[-1, :, 0], states[-1, :, 1:3] = self.start, self.ends, 0.0
        return PieceTrajectory(
            times=times.tolist(),
            positions=states[:, :, 0].tolist(),
            velocities=states[:, :, 1].tolist(),
            accelerations=states[:, :, 2].tolist(),
        )


def one_after_another(commits: Sequence[Commit]) -> Commit:
    """The motion of commits each of which is left for the next one when that begins; all of the last one."""
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
    """What every commit keeps."""

    lower: np.ndarray  # least values, shape (nv,) [rad or m]
    upper: np.ndarray  # largest values, shape (nv,)
    rates: np.ndarray  # velocity, acceleration and jerk of each coordinate, shape (nv, 3)

    @property
    def judged(self) -> np.ndarray:
        """As the judge takes them, shape (nv, 5)."""
        return np.column_stack([self.lower, self.upper, self.rates])


def towards(
    state: np.ndarray,
    velocities: np.ndarray,
    goals: np.ndarray,
    bounds: JointBounds,
    begins: float,
    piece: float,
    within: float,
) -> Commit:
    """The commit of a piece from a state (nv, 3) towards velocities (nv,); it has no number yet.

    Coordinates aren't led beyond goals (nv,), which may be infinite. It begins at a time and lasts so long [s].
    """
    count = len(velocities)
    phases, counts, ends = np.zeros((count, MOST_PHASES, 5)), np.zeros(count, np.int64), np.zeros(count)
    state = np.ascontiguousarray(state[:, :3])
    room = np.minimum(within, 0.1 * (bounds.upper - bounds.lower))
    stops = piece_and_braking(
        state, velocities, goals, bounds.lower + room, bounds.upper - room, piece, bounds.rates * (1.0 - within),
        phases, counts, ends,
    )  # fmt: skip
    return Commit(-1, begins, begins + piece, begins + max(stops, piece), state, phases, counts, cast(ChartPoint, ends))


class Judgement(enum.Enum):
    """What the judge says of a commit."""

    FREE = judge.FREE
    LIMITS = judge.LIMITS
    OWN = judge.OWN
    OBSTACLE = judge.OBSTACLE
    UNDECIDED = judge.UNDECIDED


@dataclass(frozen=True)
class Told:
    """A judgement."""

    judgement: Judgement
    evaluations: int
    pair: int  # index of the pair that isn't told apart, the robot's own first; of a limit, that of the coordinate
    time: float  # where it was refused, by the client's clock [s]

    @property
    def free(self) -> bool:
        """Whether the commit is proven."""
        return self.judgement is Judgement.FREE


class Judge:
    """A judge with its memory; not for two threads.

    Args:
        tolerances: How far the robot may be off, by coordinate, shape (nv,) [rad or m].
    """

    def __init__(self, robot: JudgedRobot, coordinates: int, bounds: JointBounds, tolerances: np.ndarray) -> None:
        self._robot, self._limits, self._tolerances = robot, bounds.judged, np.array(tolerances, float)
        self._coordinates = coordinates
        self._found = np.zeros(3)
        self._memory = self._of_pairs(64)

    def judge(
        self, commit: Commit, shapes: JudgedShapes, places: JudgedPlaces, most: int, since: float | None = None
    ) -> Told:
        """Judge a commit among obstacles.

        Args:
            since: From when on [s]; None: from its beginning.
        """
        pairs = len(self._robot.own) + len(places.met)
        if pairs > self._memory.pairs.shape[1]:
            self._memory = self._of_pairs(2 * pairs)
        stops = commit.stops - commit.begins
        begun = 0.0 if since is None else min(max(0.0, since - commit.begins), stops)
        verdict = judge.judge_motion(
            self._robot, shapes, places, commit.phases, commit.counts, commit.begins, begun, stops, commit.start,
            self._limits, self._tolerances, most, self._memory, self._found,
        )  # fmt: skip
        looked, pair, time = self._found.tolist()
        return Told(Judgement(verdict), int(looked), int(pair), time)

    def travelled(self, commit: Commit, since: float, until: float, parts: int = 16) -> float:
        """How far any point of the robot comes between two times by a commit, at most [m].

        Off by its tolerances or not.
        """
        begin = max(0.0, since - commit.begins)
        end = max(begin, until - commit.begins)
        robot, tolerances = self._robot, self._tolerances
        return float(judge.travelled(robot, commit.phases, commit.counts, begin, end, tolerances, parts, self._memory))

    def _of_pairs(self, pairs: int) -> JudgeMemory:
        pairs = max(pairs, len(self._robot.own))
        bodies, places = len(self._robot.carriers), joint_places(self._robot.joints)
        return JudgeMemory(
            places=places,
            joints=places.poses.reshape(-1, 12),
            middle=np.zeros(self._coordinates),
            half=np.zeros(self._coordinates),
            chords=np.zeros(len(places.poses)),
            swept=np.zeros(bodies),
            ways=np.zeros(bodies),
            pairs=np.zeros((DEEPEST + 2, pairs), np.int64),
            counts=np.zeros(DEEPEST + 2, np.int64),
            work=np.zeros(SIMPLEX),
            pose=np.zeros(12),
            stack=np.zeros(MOST_NODES, np.int64),
        )
