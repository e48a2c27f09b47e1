"""Events that the planner tells an observer, and their log, from which recordings are drawn.

Packed logs are stored with runs, and hold fields of events and `_KINDS` by their order: a change of these, or of
`MAX_ITERATIONS`, which chooses their paths, needs another `MAGIC` in run_log.py. Words of kinds are those of recordings
and logs. A kind with configurations also needs a branch in `StepObserver` (sequence.py), which passes others on as is.
"""

from __future__ import annotations

import enum
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, Protocol, cast

import msgspec
import numpy as np

from guidefield.read_only import ReadOnly
from guidefield.robot.model.joints import Configuration, LocalPoints


@dataclass(frozen=True)
class StageEntered:
    """A stage of the plan begins."""

    name: str
    message: str


@dataclass(frozen=True)
class StageLeft:
    """A stage of the plan has ended; `plane` is the index of the guide plane it was about, if any."""

    name: str
    outcome: str
    seconds: float
    plane: int | None = None


class StepKind(enum.Enum):
    """Kinds of steps; the values are the words of a recording."""

    START = "start"
    ADVANCE = "advance"
    DESCEND = "descend"
    SLIDE = "slide"
    REORIENT = "reorient"
    SWEEP = "sweep"
    TREE = "tree"


@dataclass(frozen=True, eq=False)
class Step(ReadOnly):
    """One accepted change of configuration."""

    kind: StepKind
    q: Configuration  # configuration after it, shape (nq,), of the planning group
    message: str
    potential: float | None = None  # potential of the robot there, if it was evaluated [m]
    plane: int | None = None


@dataclass(frozen=True)
class Note:
    """Something worth telling a person; `warning` is True where something went wrong."""

    text: str
    warning: bool = False


@dataclass(frozen=True, eq=False)
class TreeGrown:
    """The trees of a search when it ended, met or not."""

    # gives, for each tree, its nodes in the order in which it grew, local coordinates (n, nv), and the index of each
    # one's parent, shape (n,); -1 for a root. A search takes microseconds: who looks pays, and looks while it is there,
    # as the next search begins in the same memory
    trees: Callable[[], tuple[tuple[LocalPoints, np.ndarray], ...]]


@dataclass(frozen=True, eq=False)
class PathRelaxed(ReadOnly):
    """One accepted step of the optimisation."""

    path: LocalPoints  # the whole path after it, local coordinates, shape (n, nv)
    objective: float  # what is descended (planner/optimize/optimization.py), dimensionless


Event = StageEntered | StageLeft | Step | Note | TreeGrown | PathRelaxed


class Observer(Protocol):
    """An observer of planning."""

    def observe(self, event: Event) -> None:
        """Take an event; must not fail and must not be slow."""


class Silent:
    """An observer that ignores all events."""

    def observe(self, event: Event) -> None:
        """Ignore the event."""


MAX_EVENTS = 20_000  # number of events that are kept, in memory and with runs; later ones are only counted
MAX_NODES = 200  # number of nodes of a search tree that logs keep and a recording shows: the first ones
MAX_ITERATIONS = 6  # number of steps of an optimisation that a recording shows: of more, as many, evenly chosen
GROWTH_STEPS = 8  # number of steps of the timeline over which a tree is shown to grow


@dataclass(frozen=True, eq=False)
class LoggedTrees(ReadOnly):
    """The trees of a search when it ended."""

    sizes: tuple[int, ...]
    # the first `MAX_NODES` nodes of each: local coordinates (n, nv), and the index of each one's parent, shape (n,);
    # -1 for a root
    trees: tuple[tuple[LocalPoints, np.ndarray], ...]


LoggedEvent = StageEntered | StageLeft | Step | Note | LoggedTrees | PathRelaxed


class PackedArray(msgspec.Struct, array_like=True, frozen=True):
    """A float64 array as bytes."""

    shape: tuple[int, ...]
    data: bytes

    @classmethod
    def of(cls, array: np.ndarray) -> PackedArray:
        """Pack an array of any shape."""
        return cls(array.shape, np.ascontiguousarray(array, np.float64).tobytes())

    def array(self) -> np.ndarray:
        """Unpack the array.

        Raises:
            ValueError: if the bytes don't fill the shape.
        """
        return np.frombuffer(self.data).reshape(self.shape)


class PackedEvents(msgspec.Struct, array_like=True, frozen=True):
    """A log of events as columns."""

    kinds: bytes  # kind of each event, in order: its place in `_KINDS`, a byte each
    seconds: PackedArray  # time of each, since the log began [s]
    dropped: int
    rows: list[Any]
    arrays: list[PackedArray]


@dataclass(eq=False)
class EventLog:
    """Events in the order in which they came."""

    events: list[LoggedEvent] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)  # time of each, since the log began [s]
    dropped: int = 0
    began: float = field(default_factory=time.perf_counter)

    def add(self, event: Event) -> None:
        """Keep an event; costs next to nothing, trees some microseconds."""
        if len(self.events) < MAX_EVENTS:
            self.events.append(_log_event(event))
            self.seconds.append(time.perf_counter() - self.began)
        else:
            self.dropped += 1

    def steps(self) -> list[tuple[int, Step]]:
        """The accepted steps, each with its number on the timeline of steps."""
        return [(number, event) for number, event in self.number_events() if isinstance(event, Step)]

    def number_events(self) -> Iterator[tuple[int, LoggedEvent]]:
        """Each event with its number on the timeline: that of the last step before it, its own if it is one."""
        number = -1
        for event in self.events:
            before, number = number, number + _STEPS.get(type(event), 0)
            yield max(before + 1 if number > before else number, 0), event

    def pack(self) -> PackedEvents:
        """Pack the log; of an optimisation's paths only those that a recording shows."""
        relaxed = [index for index, event in enumerate(self.events) if isinstance(event, PathRelaxed)]
        shown = {relaxed[index] for index in evenly(len(relaxed), MAX_ITERATIONS)}
        rows: list[Any] = []
        arrays: list[PackedArray] = []
        for index, event in enumerate(self.events):
            match event:
                case StageEntered():
                    rows.append((event.name, event.message))
                case StageLeft():
                    rows.append((event.name, event.outcome, event.seconds, event.plane))
                case Step():
                    rows.append((event.kind.value, event.message, event.potential, event.plane))
                    arrays.append(PackedArray.of(event.q))
                case Note():
                    rows.append((event.text, event.warning))
                case LoggedTrees():
                    rows.append(event.sizes)
                    arrays += [PackedArray.of(one) for tree in event.trees for one in tree]
                case PathRelaxed():
                    rows.append((event.objective, index in shown))
                    if index in shown:
                        arrays.append(PackedArray.of(event.path))
        kinds = bytes(_KINDS.index(type(event)) for event in self.events)
        return PackedEvents(kinds, PackedArray.of(np.array(self.seconds)), self.dropped, rows, arrays)

    @classmethod
    def unpack(cls, packed: PackedEvents) -> EventLog:
        """Read a log back; paths that no recording shows are empty.

        Raises:
            ValueError, LookupError, TypeError: if it isn't whole.
        """
        arrays = iter(packed.arrays)
        events = [
            _unpack(_KINDS[kind], row, lambda: next(arrays).array())
            for kind, row in zip(packed.kinds, packed.rows, strict=True)
        ]
        return cls(events, packed.seconds.array().tolist(), packed.dropped)


def evenly(count: int, most: int) -> np.ndarray:
    """Indices of what is shown of `count` things, ascending, shape (k,): all of them, or `most` evenly chosen."""
    return np.unique(np.linspace(0, max(count - 1, 0), min(count, most)).round().astype(int))


def _log_event(event: Event) -> LoggedEvent:
    """An event that stays as it is: trees lie in memory that is used again."""
    if not isinstance(event, TreeGrown):
        return event
    trees = event.trees()
    first = tuple((cast(LocalPoints, points[:MAX_NODES]), parents[:MAX_NODES]) for points, parents in trees)
    return LoggedTrees(tuple(len(points) for points, _ in trees), first)


def _unpack(kind: type[LoggedEvent], row: Any, array: Callable[[], np.ndarray]) -> LoggedEvent:
    if kind is Step:
        step, message, potential, plane = row
        return Step(StepKind(step), cast(Any, array()), message, potential, plane)
    if kind is LoggedTrees:
        trees = tuple((cast(LocalPoints, array()), array().astype(int)) for _ in row)
        return LoggedTrees(tuple(row), trees)
    if kind is PathRelaxed:
        objective, shown = row
        return PathRelaxed(cast(LocalPoints, array() if shown else np.empty((0, 0))), objective)
    return kind(*row)


_STEPS: dict[type, int] = {Step: 1, PathRelaxed: 1, LoggedTrees: GROWTH_STEPS}
"""Number of steps of the timeline that an event takes."""
_KINDS: tuple[type[Any], ...] = (StageEntered, StageLeft, Step, Note, LoggedTrees, PathRelaxed)
"""Kinds of events, by their number in a packed log."""
