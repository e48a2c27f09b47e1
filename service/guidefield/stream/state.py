"""The state of a stream: its phases, the events that lead from one to another, the data of each; and its watchers.

A `Snapshot` is stored in journals: names of its fields and of those of its parts, and values of `Phase`, are in files;
a further field needs a default, else older files can't be read.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import msgspec
import numpy as np

from guidefield.errors import GuidefieldError, StreamUnknown
from guidefield.messages.streams import Observation, Piece, StreamGoal, StreamObstacle, StreamState, StreamUpdate
from guidefield.robot.model.joints import LocalPoint
from guidefield.stream.commit import Commit
from guidefield.stream.dodging import TimedPath
from guidefield.stream.path_planner import PathOrder

MAX_COMMITS = 64
"""Most commits that are remembered: the executed one and the last ones; so 63 may wait (docs/stream.md). At least 2, no
more than `MAX_WAITING_PIECES` of `client/stream_link.py`; another number refuses other updates, in replays too."""


class Phase(enum.Enum):
    """The phases of a stream."""

    STANDING = "standing"  # without a goal
    FOLLOWING = "following"  # on a path to the goal
    PLANNING = "planning"  # the same, while another path is planned beside the cycle
    HALTED = "halted"  # after a request to stop
    CLOSED = "closed"


class Event(enum.Enum):
    """Events that lead a stream from one phase to another; updates alone don't."""

    AIM = "aim"  # a goal was found
    STAND = "stand"  # there is no goal any more
    ORDER = "order"  # a path is to be planned
    TAKE = "take"  # that path is taken over, or given up
    STOP = "stop"
    CLOSE = "close"


ASKED = {Event.AIM: Phase.FOLLOWING, Event.STAND: Phase.STANDING, Event.STOP: Phase.HALTED, Event.CLOSE: Phase.CLOSED}
"""A client's queries lead to the same phase from each that isn't closed."""


class PhaseRule(NamedTuple):
    """The data of a phase, and the phases that follow it."""

    # fields of `State` beside those that every phase has; others are dropped when it begins
    kept: frozenset[str]
    next: dict[Event, Phase]


PHASES = {
    Phase.STANDING: PhaseRule(frozenset(), ASKED),
    Phase.FOLLOWING: PhaseRule(frozenset({"pursuit"}), ASKED | {Event.ORDER: Phase.PLANNING}),
    Phase.PLANNING: PhaseRule(frozenset({"pursuit", "ordered"}), ASKED | {Event.TAKE: Phase.FOLLOWING}),
    Phase.HALTED: PhaseRule(frozenset(), ASKED),
    Phase.CLOSED: PhaseRule(frozenset(), {Event.CLOSE: Phase.CLOSED}),
}


class Pursuit(msgspec.Struct, eq=False):
    """The goal's configurations, and the path that is followed to one of them."""

    goals: np.ndarray  # its configurations, (k, nv)
    path: TimedPath | None = None  # the path that is followed; None: nothing is known of one
    place: float = 0.0  # the robot's place along it [s]
    refused: int = 0  # updates without a piece, one after the other
    unfound: bool = False  # whether no path was found at the last planning

    def follow(self, path: TimedPath) -> None:
        """Follow a path from its beginning."""
        self.path, self.place = path, 0.0


class State(msgspec.Struct, eq=False):
    """Everything of a stream that changes, but its obstacles and random numbers."""

    commits: dict[int, Commit]
    phase: Phase
    last: int  # number of the commit that was sent last
    current: int  # number of the one that is executed to its stop
    now: float  # the client's time [s]; -inf: no update came yet
    fresh: bool  # whether something was observed for the first time by an update without an answer
    sought: int  # number of searches for goals
    goal: int  # number of the goal
    planned: float  # the time of the last order of a path [s]; -inf: none was
    pursuit: Pursuit | None
    ordered: PathOrder | None  # the path that is being planned

    @classmethod
    def at_rest(cls, start: LocalPoint) -> State:
        """Return the state of a stream that was opened, at coordinates of shape (nv,)."""
        commits = {0: Commit.standing(start, 0.0)}
        return cls(commits, Phase.STANDING, 0, 0, -np.inf, False, 0, 0, -np.inf, None, None)

    def copy(self) -> State:
        """Return a copy that stays as it is while this one goes on."""
        pursuit = None if self.pursuit is None else msgspec.structs.replace(self.pursuit)
        return msgspec.structs.replace(self, commits=dict(self.commits), pursuit=pursuit)

    def enter(self, event: Event) -> None:
        """Begin the phase that an event leads to.

        Raises:
            StreamUnknown: if the stream is closed.
        """
        if event is not Event.CLOSE:
            self.require_open()
        before = PHASES[self.phase]
        self.phase = before.next[event]
        for name in before.kept - PHASES[self.phase].kept:
            setattr(self, name, None)

    def require_open(self) -> None:
        """Raise StreamUnknown if the stream is closed."""
        if self.phase is Phase.CLOSED:
            raise StreamUnknown("the stream is closed: what was sent last is executed to its end; open another")

    def aim(self, goals: np.ndarray | None) -> None:
        """Begin with another goal, configurations of shape (k, nv), or none: nothing is known of a path to it."""
        self.enter(Event.STAND if goals is None else Event.AIM)
        self.goal, self.pursuit = self.goal + 1, None if goals is None else Pursuit(goals)

    def order(self, ordered: PathOrder) -> None:
        """Have another path planned beside the cycle."""
        self.enter(Event.ORDER)
        self.ordered, self.planned = ordered, self.now

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
        if self.pursuit is not None:
            self.pursuit.path = None


class KeptObstacle(msgspec.Struct, frozen=True):
    """An obstacle of a stream: its declaration, its last observation, and whether it is gone."""

    declared: StreamObstacle
    seen: Observation | None
    gone: bool


class Snapshot(msgspec.Struct, frozen=True):
    """All that a stream goes on from."""

    state: State
    random: str
    obstacles: tuple[KeptObstacle, ...]


def encode_part(value: Any) -> Any:
    """Write an array as its type, shape and bytes, a number as it is, a path by its arrays: a hook of `msgspec`."""
    if isinstance(value, TimedPath):
        return value.points, value.speeds, value.times
    if not value.shape:
        return value.item()
    return value.dtype.str, value.shape, np.ascontiguousarray(value).tobytes()


def decode_part(kind: Any, written: Any) -> Any:
    """Read what `encode_part` wrote."""
    if kind is TimedPath:
        return TimedPath(*(decode_part(np.ndarray, one) for one in written))
    dtype, shape, data = written
    return np.frombuffer(data, np.dtype(dtype)).reshape(shape).copy()


def random_state(rng: np.random.Generator) -> str:
    """The state of random numbers, as JSON."""
    state = rng.bit_generator.state  # of numbers of 128 bits, which are written as text
    words = {name: str(value) for name, value in state["state"].items()}
    return msgspec.json.encode({**state, "state": words}).decode()


def restore_random(rng: np.random.Generator, state: str) -> None:
    """Have random numbers go on from a state."""
    words = msgspec.json.decode(state)
    words["state"] = {name: int(value) for name, value in words["state"].items()}
    rng.bit_generator.state = words


class StreamWatcher:
    """A watcher of a stream that does nothing; methods of others may not take long, or raise."""

    def begin_update(self) -> None:
        """Note that work on an update begins."""

    def end_update(
        self,
        update: StreamUpdate,
        answer: Piece | StreamState | None,
        refused: GuidefieldError | None,
        *,
        noted: bool,
        took: bool,
    ) -> None:
        """Take the outcome of an update.

        Args:
            answer: None where it was noted, or refused.
        """

    def seek(self, goal: StreamGoal) -> None:
        """Note that a search for configurations of a goal begins."""

    def change_goal(self, number: int | None) -> None:
        """Note that the goal is another one: that of the n-th search; None: to stand."""

    def halt(self) -> None:
        """Note a request to stop."""

    def may_rest(self, snapshot: Callable[[], Snapshot], *, planning: bool) -> None:
        """A snapshot can be taken; a path that is being planned is given up then, and planned again."""


class Watchers(StreamWatcher):
    """Several watchers as one."""

    def __init__(self, *watchers: StreamWatcher) -> None:
        def tell(name: str) -> Callable[..., None]:
            calls = [getattr(one, name) for one in watchers]

            def tell_each(*given: Any, **named: Any) -> None:
                for call in calls:
                    call(*given, **named)

            return tell_each

        for name in ("begin_update", "end_update", "seek", "change_goal", "halt", "may_rest"):
            setattr(self, name, tell(name))
