"""Commits: a piece of constant jerk and the hardest braking after it, as one motion to a stop.

The judge proves the curve of a commit, clients get its `trajectory`: both have to be the same motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import cast

import numpy as np

from guidefield.kernels.stream.judge import find_states
from guidefield.kernels.stream.way import MOST_PHASES, piece_and_braking
from guidefield.kernels.timing.carried_rates import MotionPolynomials
from guidefield.messages.streams import PieceTrajectory
from guidefield.read_only import ReadOnly, read_only
from guidefield.robot.model.spaces import ChartPoint

SAME_TIME = 1e-9  # knots that are closer than this become one [s]; so do those within `ROUNDED`
ROUNDED = 16  # steps of a double at the client's clock
STANDING = 1e-6  # duration for which a motion that stands from its beginning on is judged [s]


@dataclass(frozen=True, eq=False)
class Commit(ReadOnly):
    """A motion that ends in a stop."""

    number: int
    begins: float  # its begin, by the client's clock [s]
    brakes: float  # begin of its braking [s]
    stops: float  # time from which the robot stands [s]
    start: np.ndarray  # value, velocity and acceleration at its beginning, shape (nv, 3)
    phases: np.ndarray  # of each coordinate, shape (nv, k, 5), times from `begins`, as kernels/stream/way.py has them
    counts: np.ndarray  # number of phases of each coordinate, shape (nv,)
    ends: ChartPoint  # configuration in which the robot stands in the end, shape (nv,)
    follows: int = 0  # number of the commit that it follows
    goal: int = 0  # number of its goal
    at_goal: bool = False  # whether it ends there

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
    is the share of each limit that is left for rounding.
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
