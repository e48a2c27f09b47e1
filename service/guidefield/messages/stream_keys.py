"""Decode queries on the keys of streams."""

from __future__ import annotations

from dataclasses import dataclass

from guidefield.errors import MalformedRequest
from guidefield.messages import codec
from guidefield.messages.keys import Query
from guidefield.messages.served import SERVED
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
class ReadStream:
    """Read the state of a stream."""

    name: str


@dataclass(frozen=True)
class EndStream:
    """End a stream."""

    name: str


@dataclass(frozen=True)
class AimStream:
    """Give a stream another goal; the stream decodes the payload."""

    name: str


@dataclass(frozen=True)
class JudgeStream:
    """Judge the last piece of a stream; the stream decodes the payload."""

    name: str


@dataclass(frozen=True)
class HaltStream:
    """Stop the robot of a stream."""

    name: str


@dataclass(frozen=True)
class RecordStream:
    """Make the recording of a stream, open or ended, from its stored journal."""

    name: str


StreamQuery = OpenStream | ListStreams | ReadStream | EndStream | AimStream | JudgeStream | HaltStream | RecordStream


def is_stream(query: Query) -> bool:
    """Return whether a query is about streams."""
    return bool(query.key) and query.key[0] == STREAMS


def check(query: Query) -> None:
    """Check all of a query about streams but its payload.

    Raises:
        MalformedRequest: if its key isn't served, or it has parameters or a payload that don't fit it.
    """
    key, payload = "/".join(query.key), bool(query.payload)
    valid: set[str] = set()
    match query.key[1:]:
        case () | (_, "goal" | "judge"):
            payload = False
        case (_,):
            valid = {"delete"}
        case (_, "stop" | "recording"):
            pass
        case _:
            raise MalformedRequest(
                f"nothing is served at {key!r}; served are {', '.join(SERVED)}", key=key, served=list(SERVED)
            )
    unknown = sorted(set(query.parameters) - valid)
    if unknown:
        told = ", ".join(valid) or "none"
        raise MalformedRequest(f"unknown parameter {unknown[0]!r} at {key!r}; valid: {told}", parameter=unknown[0])
    if payload:
        raise MalformedRequest(f"a query on {key!r} of this kind takes no payload", key=key)


def decode_stream_query(query: Query) -> StreamQuery:
    """Decode the request of a query about streams.

    Raises:
        MalformedRequest: as `check`, and if its payload is malformed.
        RequestTooLarge: if the payload is too long to be decoded.
    """
    check(query)
    if len(query.key) == 1:
        if not query.payload:
            return ListStreams()
        return OpenStream(codec.decode(query.payload, StreamOpen, query.encoding))
    name = query.key[1]
    if len(query.key) == 2:
        return EndStream(name) if "delete" in query.parameters else ReadStream(name)
    if query.key[2] == "stop":
        return HaltStream(name)
    if query.key[2] == "recording":
        return RecordStream(name)
    if not query.payload:
        asked = "a goal is asked for with a StreamAim" if query.key[2] == "goal" else "to judge takes a StreamJudge"
        raise MalformedRequest(f"{asked} as payload", key="/".join(query.key))
    return AimStream(name) if query.key[2] == "goal" else JudgeStream(name)
