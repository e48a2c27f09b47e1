"""One stream of a service: it is opened or refused, ends after a silence, and says why to everybody who waits."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, cast

import msgspec
import pytest

from guidefield.endpoint import streams
from guidefield.endpoint.streams import OpenStream
from guidefield.errors import Preempted, RobotInvalid, StreamUnknown, TimedOut
from guidefield.messages.codec import Encoding
from guidefield.messages.identities import Asker
from guidefield.messages.streams import StreamState
from guidefield.stream_worker import StreamConversation
from tests.journeys.service import SO_WITHIN
from tests.worker_setups import StreamInWords


class Published:
    """What a stream published."""

    def __init__(self) -> None:
        self.told: list[tuple[str, bytes]] = []
        self.left = threading.Event()
        self.changed = threading.Condition()

    def publish(self, key: str, payload: bytes, _encoding: Encoding) -> None:
        with self.changed:
            self.told.append((key, payload))
            self.changed.notify_all()

    def await_told(self, count: int) -> list[tuple[str, bytes]]:
        with self.changed:
            assert self.changed.wait_for(lambda: len(self.told) >= count, SO_WITHIN)
            return self.told

    def last_state(self) -> StreamState:
        key, payload = self.told[-1]
        assert key == "state"
        return msgspec.json.decode(payload, type=StreamState)


@contextmanager
def opened(*, refuses: bool = False) -> Iterator[tuple[OpenStream, Published]]:
    published = Published()
    conversation: Any = StreamInWords(refuses=refuses)
    stream = OpenStream(
        ("plain", "s"),
        Asker(),
        (Encoding.JSON, b"{}"),
        cast(StreamConversation, conversation),
        1 << 30,
        published.publish,
        lambda _: published.left.set(),
    )
    stream.start()
    yield stream, published
    stream.end(Preempted("the test is over")).result(SO_WITHIN)
    assert published.left.is_set()


def test_it_counts_what_it_takes_and_ends_for_a_reason() -> None:
    with opened() as (stream, published):
        reply = stream.opened.result(SO_WITHIN)
        assert (reply.robot, reply.start, reply.goal, reply.warnings, reply.stops) == ("ur5", [0.5], 1, ["odd"], None)
        stream.update(b"one", Encoding.JSON)
        assert published.await_told(1) == [("pieces", b"one")]
        read = stream.read()
        assert (read.updates, read.pieces, read.executing, read.stops, read.last) == (1, 1, 7, 1.5, None)
        aimed = stream.ask("aim", Encoding.JSON, b"{}")
        over = stream.end(Preempted("it was asked to end"))
        with pytest.raises(StreamUnknown):
            stream.ask("stop", Encoding.JSON)
        over.result(SO_WITHIN)
        with pytest.raises(Preempted, match="asked to end"):
            aimed.result(SO_WITHIN)
        state = published.last_state()
        assert (state.reason, state.executing, state.stops) == ("ended", 7, 1.5)
        assert state.error.name == "PREEMPTED"
        with pytest.raises(StreamUnknown):
            stream.ask("stop", Encoding.JSON)


def test_one_that_can_not_be_opened_says_why_and_publishes_nothing() -> None:
    with opened(refuses=True) as (stream, published):
        with pytest.raises(RobotInvalid, match="there is no robot 'ur55'"):
            stream.opened.result(SO_WITHIN)
        assert published.left.wait(SO_WITHIN)
        assert published.told == []


def test_silence_ends_it_and_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(streams, "SILENCE", 0.3)
    with opened() as (stream, published):
        assert stream.opened.result(SO_WITHIN).silence == 0.3
        assert published.left.wait(SO_WITHIN)
        published.await_told(1)
        state = published.last_state()
        assert state.error.name == TimedOut.code.name
        assert "no update came for 0.3 s" in state.error.message


def test_one_that_is_not_open_in_time_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(streams, "OPENED_WITHIN", 0.0)
    monkeypatch.setattr(streams.OpenStream, "_hear", lambda *_: None)  # its process says that it is open to nobody
    with opened() as (stream, _), pytest.raises(TimedOut, match="wasn't open after"):
        stream.opened.result(SO_WITHIN)
