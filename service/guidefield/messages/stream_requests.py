"""Requests about an open stream, and their replies; updates and pieces are in `streams`."""

from __future__ import annotations

from typing import Literal

from guidefield.messages.streams import StreamGoal, StreamState
from guidefield.messages.values import Message, Reply, require_finite_number


class StreamAim(Message):
    """A stream gets another goal.

    Attributes:
        goal: What to reach; null: to stand. Going on after a stop is asked for in the same way.
        schema: Version of this message.
    """

    goal: StreamGoal | None = None
    schema: Literal[1] = 1


class StreamAimed(Reply):
    """A stream has another goal.

    Attributes:
        goal: Its number, which its pieces have.
    """

    goal: int
    schema: int = 1


class StreamJudge(Message):
    """Ask whether the last piece and its stop are still proven, by what was seen last.

    Attributes:
        time: From when on, by the client's clock [s].
        schema: Version of this message.
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
        stops: When the robot stands, by the client's clock [s].
        pair: What couldn't be told apart: a link, and a link or an obstacle; null where it is proven, or undecided.
        time: Where that is [s]; null as there.
        evaluations: Configurations at which it was certified.
    """

    proven: bool
    executing: int
    stops: float
    pair: tuple[str, str] | None
    time: float | None
    evaluations: int
    schema: int = 1


class StreamReply(Reply):
    """A stream that is open.

    Attributes:
        stream_id: Its name.
        robot: The robot, by its name or its kind.
        position_names: Names of the columns of its pieces.
        start: Where the robot stood when it was opened, in their order [rad or m].
        goal: Number of the goal that was set last; 0: there was none yet.
        executing: Number of the last piece; 0: there is none.
        stops: When the robot stands if no piece follows, by the client's clock [s]; null: it does.
        updates: How many updates came.
        pieces: How many of them were answered with a piece.
        silence: After so long without an update it ends [s].
        age: How long it has been open [s].
        warnings: Harmless peculiarities of the request.
        last: The last state that was told; null: none.
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
    """The streams that are open, of the user who asks; for operators all, those of users as `user:name`.

    Attributes:
        streams: Their names.
        most: How many the service takes.
    """

    streams: list[str]
    most: int
    schema: int = 1
