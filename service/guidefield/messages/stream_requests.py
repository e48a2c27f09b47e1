"""Requests and replies about open streams, and their keys, `streams/<id>/...`; streams.py has motions and updates.

Chunks of keys and names of fields are the wire. A further query needs its messages here, in `StreamMessage`, too, a row
in `KEYS` of keys.py, a way through `endpoint/streams.py`, and its answer in stream_worker.py. Docstrings of messages
are in docs/wire.schema.json: after a change, `tools/wire_page`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from guidefield.errors import MalformedRequest
from guidefield.messages import codec
from guidefield.messages.keys import Query, refuse_key, require_no_payload, require_parameters
from guidefield.messages.streams import Piece, StreamGoal, StreamOpen, StreamState, StreamUpdate
from guidefield.messages.values import Message, Reply, require_finite_number

STREAMS = "streams"


@dataclass(frozen=True)
class OpenStream:
    """Open a stream."""

    request: StreamOpen


@dataclass(frozen=True)
class ListStreams:
    """List the open streams."""


@dataclass(frozen=True)
class _OneStream:
    name: str


class ReadStream(_OneStream):
    """Read the state of a stream."""


class EndStream(_OneStream):
    """End a stream."""


class AimStream(_OneStream):
    """Give a stream another goal; the stream decodes the payload."""


class JudgeStream(_OneStream):
    """Judge the last piece of a stream; the stream decodes the payload."""


class HaltStream(_OneStream):
    """Stop the robot of a stream."""


class RecordStream(_OneStream):
    """Make the recording of a stream, open or ended, from its stored journal."""


StreamQuery = OpenStream | ListStreams | _OneStream

_BELOW_ONE: dict[str, type[_OneStream]] = {
    "stop": HaltStream,
    "recording": RecordStream,
    "goal": AimStream,
    "judge": JudgeStream,
}
"""Queries by the chunk below a stream's name."""
_TAKING = {"goal": "a goal is asked for with a StreamAim", "judge": "to judge takes a StreamJudge"}
"""Chunks whose queries need a payload, with the sentence of the error if it is missing."""


def is_stream(query: Query) -> bool:
    """Return whether a query is about streams."""
    return bool(query.key) and query.key[0] == STREAMS


def check(query: Query) -> None:
    """Check all of a query about streams but its payload; raises MalformedRequest where one doesn't fit its key."""
    below = query.key[2:]
    if len(below) > 1 or not _BELOW_ONE.keys() >= {*below}:
        raise refuse_key(query)
    require_parameters(query, {"delete"} if len(query.key) == 2 else ())
    if len(query.key) > 1 and not _TAKING.keys() & {*below}:
        require_no_payload(query)


def decode_stream_query(query: Query) -> StreamQuery:
    """Decode the request of a query about streams; raises as `check`, and for a malformed or too large payload."""
    check(query)
    match query.key[1:]:
        case ():
            return (
                OpenStream(codec.decode(query.payload, StreamOpen, query.encoding)) if query.payload else ListStreams()
            )
        case (name,):
            return EndStream(name) if "delete" in query.parameters else ReadStream(name)
        case (name, below):
            if below in _TAKING and not query.payload:
                raise MalformedRequest(f"{_TAKING[below]} as payload", key="/".join(query.key))
            return _BELOW_ONE[below](name)
    raise refuse_key(query)


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


StreamMessage = (
    StreamOpen
    | StreamUpdate
    | StreamAim
    | StreamJudge
    | Piece
    | StreamState
    | StreamReply
    | StreamAimed
    | StreamJudged
    | StreamsReply
)
