"""Everything that a stream goes on from, as plain data: what a recording's file begins with, to the last bit."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec
import numpy as np

from guidefield.messages.streams import Observation, StreamObstacle
from guidefield.stream.commit import Commit


class Rows(msgspec.Struct, frozen=True):
    """An array.

    Attributes:
        shape: Its shape.
        kind: Its NumPy type.
        data: Its bytes, row by row.
    """

    shape: tuple[int, ...]
    kind: str
    data: bytes

    @classmethod
    def of(cls, array: np.ndarray) -> Rows:
        """An array of any shape."""
        return cls(array.shape, array.dtype.str, np.ascontiguousarray(array).tobytes())

    def array(self) -> np.ndarray:
        """It, of its `shape`."""
        return np.frombuffer(self.data, np.dtype(self.kind)).reshape(self.shape).copy()


class KeptCommit(msgspec.Struct, frozen=True):
    """A commit; the fields are those of `Commit`."""

    number: int
    begins: float
    brakes: float
    stops: float
    start: Rows
    phases: Rows
    counts: Rows
    ends: Rows
    follows: int
    goal: int
    at_goal: bool

    @classmethod
    def of(cls, commit: Commit) -> KeptCommit:
        """What is kept of a commit."""
        given: dict[str, Any] = {name: getattr(commit, name) for name in cls.__struct_fields__}
        kept: dict[str, Any] = {
            name: Rows.of(one) if isinstance(one, np.ndarray) else one for name, one in given.items()
        }
        return cls(**kept)

    def commit(self) -> Commit:
        """The commit."""
        given: dict[str, Any] = {name: getattr(self, name) for name in self.__struct_fields__}
        held: dict[str, Any] = {name: one.array() if isinstance(one, Rows) else one for name, one in given.items()}
        return Commit(**held)


class KeptObstacle(msgspec.Struct, frozen=True):
    """An obstacle that a stream knows: what it was declared as, where it was seen last, and whether it is gone."""

    declared: StreamObstacle
    seen: Observation | None
    gone: bool


class Snapshot(msgspec.Struct, frozen=True):
    """What a stream goes on from.

    Attributes:
        now: The client's time [s]; None: no update came yet.
        commits: Those that are remembered.
        last: Number of the last one.
        halted: Whether a stop was asked for.
        fresh: Whether something was seen for the first time by an update that was not answered.
        sought: For how many goals configurations were looked for.
        goal: Number of the goal.
        goals: Its configurations, (k, nv); None: to stand.
        way: Points of the way that is followed, (m, nv); None: there is none.
        times: When to be at each of these [s], (m,); None: there is none.
        place: How far along it is [s].
        refused: Updates without a piece, in a row.
        unfound: Whether the last way wasn't found.
        planned: When a way was planned last [s]; None: none was.
        random: State of the random numbers, as JSON.
        obstacles: All but those of the scene.
    """

    now: float | None
    commits: tuple[KeptCommit, ...]
    last: int
    halted: bool
    fresh: bool
    sought: int
    goal: int
    goals: Rows | None
    way: Rows | None
    times: Rows | None
    place: float
    refused: int
    unfound: bool
    planned: float | None
    random: str
    obstacles: tuple[KeptObstacle, ...]


def random_state(rng: np.random.Generator) -> str:
    """The state of random numbers, as JSON."""
    return msgspec.json.encode(_as_words(rng.bit_generator.state)).decode()


def restore_random(rng: np.random.Generator, state: str) -> None:
    """Have random numbers go on from a state."""
    told = msgspec.json.decode(state)
    told["state"] = {name: int(value) for name, value in told["state"].items()}
    rng.bit_generator.state = told


def _as_words(state: Mapping[str, Any]) -> dict[str, Any]:
    """The same, with numbers of 128 bits as text."""
    return {**state, "state": {name: str(value) for name, value in state["state"].items()}}
