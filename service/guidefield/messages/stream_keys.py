"""Decode queries on the keys of streams."""

from __future__ import annotations

from dataclasses import dataclass

from guidefield.errors import MalformedRequest
from guidefield.messages import codec
from guidefield.messages.keys import Query, refuse_key, require_no_payload, require_parameters
from guidefield.messages.streams import StreamOpen

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
"""Sentences about payloads that are missing."""


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
