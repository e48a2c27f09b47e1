"""Keys of streams: what a query asks for, and what doesn't fit its key."""

import pytest

from guidefield.errors import MalformedRequest
from guidefield.messages.codec import Encoding
from guidefield.messages.keys import Query
from guidefield.messages.stream_requests import (
    AimStream,
    EndStream,
    HaltStream,
    JudgeStream,
    ListStreams,
    OpenStream,
    ReadStream,
    RecordStream,
    decode_stream_query,
    is_stream,
)

OPEN = b'{"robot": "ur5", "scene": "table"}'


def query(key: str, payload: bytes = b"", **parameters: str) -> Query:
    return Query(tuple(key.split("/")), parameters, payload, Encoding.JSON)


def test_what_is_asked_for() -> None:
    assert decode_stream_query(query("streams")) == ListStreams()
    opened = decode_stream_query(query("streams", OPEN))
    assert isinstance(opened, OpenStream)
    assert opened.request.robot == "ur5"
    assert decode_stream_query(query("streams/a")) == ReadStream("a")
    assert decode_stream_query(query("streams/a", delete="")) == EndStream("a")
    assert decode_stream_query(query("streams/a/goal", b"{}")) == AimStream("a")
    assert decode_stream_query(query("streams/a/judge", b"{}")) == JudgeStream("a")
    assert decode_stream_query(query("streams/a/stop")) == HaltStream("a")
    assert decode_stream_query(query("streams/a/recording")) == RecordStream("a")
    assert is_stream(query("streams/a"))
    assert not is_stream(query("scenes/streams"))


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        (query("streams/a/pieces"), "nothing is served at 'streams/a/pieces'; served are"),
        (query("streams/a/b/c"), "nothing is served"),
        (query("streams", OPEN, delete=""), "unknown parameter 'delete' at 'streams'; valid: none"),
        (query("streams/a", robot="x"), "unknown parameter 'robot' at 'streams/a'; valid: delete"),
        (query("streams/a", b"{}"), "takes no payload"),
        (query("streams/a/stop", b"{}"), "takes no payload"),
        (query("streams/a/recording", b"{}"), "takes no payload"),
        (query("streams/a/recording", robot="x"), "unknown parameter 'robot' at 'streams/a/recording'; valid: none"),
        (query("streams/a/goal"), "StreamAim"),
        (query("streams/a/judge"), "StreamJudge"),
        (query("streams", b'{"robot": "ur5"}'), "scene"),
        (query("streams", OPEN[:-1] + b', "stream_id": "a/b"}'), "stream_id"),
        (query("streams", OPEN[:-1] + b', "latency": NaN}'), "NaN|malformed|invalid"),
    ],
)
def test_what_does_not_fit(asked: Query, words: str) -> None:
    with pytest.raises(MalformedRequest, match=words):
        decode_stream_query(asked)
