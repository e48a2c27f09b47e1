"""Requests about an open stream, and their replies; updates and pieces are in `streams`."""

from __future__ import annotations

from typing import Literal

from guidefield.messages.streams import StreamGoal, StreamState
from guidefield.messages.values import Message, Reply, require_finite_number


class StreamAim(Message):
    """Give a stream another goal.

    Attributes:
        goal: The goal; null: to stand. A goal also ends a stop.
    """

    goal: StreamGoal | None = None
    schema: Literal[1] = 1


class StreamAimed(Reply):
    """The success of another goal.

    Attributes:
        goal: Its number, which its pieces carry.
    """

    goal: int
    schema: int = 1


class StreamJudge(Message):
    """Ask whether the last piece and its stop are still proven by the last observations.

    Attributes:
        time: Begin of the part to prove, by the client's clock [s].
    """

    time: float
    schema: Literal[1] = 1

    def __post_init__(self) -> None:
        require_finite_number("time", self.time)


class StreamJudged(Reply):
    """The verdict on the last piece and its stop, by the last observations.

    Attributes:
        proven: Whether they are.
        executing: Number of that piece; 0: the robot stands at the start.
        stops: Time at which the robot stands, by the client's clock [s].
        pair: The bodies that couldn't be proven apart: a link, and a link or an obstacle; null if proven, or undecided.
        time: Time of that [s]; null as there.
        evaluations: Segments of time in which it was certified.
    """

    proven: bool
    executing: int
    stops: float
    pair: tuple[str, str] | None
    time: float | None
    evaluations: int
    schema: int = 1


class StreamReply(Reply):
    """An open stream.

    Attributes:
        stream_id: Its name.
        robot: The robot, by its name or its kind.
        position_names: Names of the columns of its pieces.
        start: The robot's configuration when it was opened, in their order [rad or m].
        goal: Number of the goal that was set last; 0: there was none yet.
        executing: Number of the last piece; 0: there is none.
        stops: Time at which the robot stands if no piece follows, by the client's clock [s]; null: it stands now.
        updates: Number of updates.
        pieces: Number of pieces.
        silence: Longest time without an update, after which it ends [s].
        age: Time since it was opened [s].
        warnings: Harmless peculiarities of the request.
        last: The last published state; null: none.
    """

    stream_id: str
    robot: str
    position_names: list[str]
    start: list[float]
    goal: int
    executing: int
    stops: float | None
    updates: int
    pieces: int
    silence: float
    age: float
    warnings: list[str] = []
    last: StreamState | None = None
    schema: int = 1


class StreamsReply(Reply):
    """The open streams of the caller; for operators all, those of users as `user:name`.

    Attributes:
        streams: Their names.
        most: The largest number of open streams.
    """

    streams: list[str]
    most: int
    schema: int = 1
