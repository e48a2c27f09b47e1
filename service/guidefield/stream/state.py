"""The state of a stream: its phase, commits and way; and the same as plain data, to the last bit."""

from __future__ import annotations

import enum
from collections.abc import Callable, Iterable
from typing import Any

import msgspec
import numpy as np

from guidefield.errors import GuidefieldError
from guidefield.messages.streams import Observation, Piece, StreamGoal, StreamObstacle, StreamState, StreamUpdate
from guidefield.robot.model.spaces import ChartPoint
from guidefield.stream.commit import Commit
from guidefield.stream.dodging import Way

MAX_COMMITS = 64  # most commits that are remembered: the one that is executed and the last ones


class Phase(enum.Enum):
    """The phases of a stream: without a goal, with one, told to stop, and closed."""

    STANDING = "standing"
    GOING = "going"
    HALTED = "halted"
    CLOSED = "closed"


_OPEN = frozenset(Phase)

TRANSITIONS = {Phase.STANDING: _OPEN, Phase.GOING: _OPEN, Phase.HALTED: _OPEN, Phase.CLOSED: frozenset[Phase]()}
"""The phases that may follow each phase: a closed stream stays closed."""


class State(msgspec.Struct, eq=False):
    """Everything of a stream that changes, but its obstacles, random numbers and what is under way beside the cycle."""

    commits: dict[int, Commit]
    last: int
    current: int
    phase: Phase
    now: float  # the client's time [s]; -inf: no update came yet
    fresh: bool  # whether something was seen for the first time by an update that was not answered
    sought: int
    goal: int
    goals: np.ndarray | None  # its configurations, (k, nv); None: to stand
    way: Way | None  # the way that is followed; None: there is none
    place: float  # how far along it is [s]
    refused: int
    unfound: bool
    planned: float  # when a way was planned last [s]; -inf: none was

    @classmethod
    def at_rest(cls, start: ChartPoint) -> State:
        """Return the state of a stream that was opened, at coordinates of shape (nv,)."""
        commits = {0: Commit.standing(start, 0.0)}
        return cls(commits, 0, 0, Phase.STANDING, -np.inf, False, 0, 0, None, None, 0.0, 0, False, -np.inf)

    def copy(self) -> State:
        """Return a copy that stays as it is while this one goes on."""
        return msgspec.structs.replace(self, commits=dict(self.commits))

    def enter(self, phase: Phase) -> None:
        """Begin a phase, where it may follow this one."""
        if phase in TRANSITIONS[self.phase]:
            self.phase = phase

    def aim(self, goals: np.ndarray | None) -> None:
        """Begin with another goal, configurations of shape (k, nv), or none: nothing is known of a way to it."""
        self.enter(Phase.STANDING if goals is None else Phase.GOING)
        self.goal, self.goals = self.goal + 1, goals
        self.way, self.place, self.refused, self.unfound = None, 0.0, 0, False

    def follow(self, way: Way) -> None:
        """Follow a way from its beginning."""
        self.way, self.place = way, 0.0

    def begin(self, now: float) -> None:
        """Set the client's clock [s]; until the first update the robot stands at its start."""
        if not np.isfinite(self.now):
            self.commits[0] = Commit.standing(self.commits[0].ends, now)
        self.now = now

    def find_pending(self, number: int, now: float) -> list[Commit]:
        """Return the commit of a number, the one that it follows, and so on back to the one that is executed now."""
        found = [self.commits[number]]
        while (last := found[-1]).begins > now and last.follows != last.number and last.follows in self.commits:
            found.append(self.commits[last.follows])
        return found

    def find_executed(self, now: float) -> list[Commit]:
        """Return the commits that are executed from now on, in order, the last of them to its stop."""
        return self.find_pending(self.current, now)[::-1]

    def find_base(self, executing: int | None, now: float) -> Commit:
        """Return the commit that the next piece follows: the one that is executed, or the last of those pending."""
        number = self.last if executing is None else executing
        is_pending = any(one.number == number for one in self.find_pending(self.last, now))
        return self.commits[self.last if is_pending else number]

    def add(self, sent: Commit, executed: Iterable[Commit]) -> None:
        """Add a commit that was sent; forget the oldest that isn't executed or pending."""
        self.commits[sent.number] = sent
        self.last = self.current = sent.number
        while len(self.commits) > MAX_COMMITS:
            del self.commits[min(self.commits.keys() - {one.number for one in executed})]

    def stand_at(self, stood: Commit) -> None:
        """Go on from where the robot stands, which isn't where the piece of this number had it."""
        self.commits[stood.number] = stood
        self.last = self.current = stood.number
        self.way = None


class KeptObstacle(msgspec.Struct, frozen=True):
    """An obstacle that a stream knows: what it was declared as, where it was seen last, and whether it is gone."""

    declared: StreamObstacle
    seen: Observation | None
    gone: bool


class Snapshot(msgspec.Struct, frozen=True):
    """What a stream goes on from."""

    state: State
    random: str
    obstacles: tuple[KeptObstacle, ...]


def encode_part(value: Any) -> Any:
    """Write an array as its type, shape and bytes, a number as it is, a way by its arrays: a hook of `msgspec`."""
    if isinstance(value, Way):
        return value.points, value.speeds, value.times
    if not value.shape:
        return value.item()
    return value.dtype.str, value.shape, np.ascontiguousarray(value).tobytes()


def decode_part(kind: Any, written: Any) -> Any:
    """Read what `encode_part` wrote."""
    if kind is Way:
        return Way(*(decode_part(np.ndarray, one) for one in written))
    dtype, shape, data = written
    return np.frombuffer(data, np.dtype(dtype)).reshape(shape).copy()


def random_state(rng: np.random.Generator) -> str:
    """The state of random numbers, as JSON."""
    state = rng.bit_generator.state  # of numbers of 128 bits, which are told as text
    words = {name: str(value) for name, value in state["state"].items()}
    return msgspec.json.encode({**state, "state": words}).decode()


def restore_random(rng: np.random.Generator, state: str) -> None:
    """Have random numbers go on from a state."""
    told = msgspec.json.decode(state)
    told["state"] = {name: int(value) for name, value in told["state"].items()}
    rng.bit_generator.state = told


class Watching:
    """Hears of a stream, and does nothing about it; none of these may take long, or raise."""

    def begun(self) -> None:
        """An update came, and is worked on."""

    def updated(
        self,
        update: StreamUpdate,
        answer: Piece | StreamState | None,
        refused: GuidefieldError | None,
        *,
        noted: bool,
        took: bool,
    ) -> None:
        """An update was worked on.

        Args:
            answer: What was answered; None where it was noted, or refused.
        """

    def sought(self, goal: StreamGoal) -> None:
        """Configurations of a goal are looked for."""

    def aimed(self, number: int | None) -> None:
        """The goal is another one: what was looked for as the n-th; None: to stand."""

    def halted(self) -> None:
        """A stop was asked for."""

    def may_rest(self, snapshot: Callable[[], Snapshot], *, planning: bool) -> None:
        """What the stream goes on from can be had.

        Args:
            snapshot: That; a way that is being planned is given up then, and planned again.
        """
