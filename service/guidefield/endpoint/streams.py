"""The streams of a service: their opening, the queries and updates for them, and their end.

Theory of operation. Each stream has a process for its life (`open_stream.py`). Its updates are put by the client, and
can't be answered: the stream's key ``state`` tells their faults. Queries about it are answered as all others. A stream
belongs to its user; clients that can't use the user's keys can neither see nor update it.
"""

from __future__ import annotations

import logging
import threading
import time
import uuid
from collections import Counter
from collections.abc import Callable
from concurrent.futures import Future

import msgspec
import zenoh

from guidefield.endpoint.open_stream import OpenStream, Publish
from guidefield.endpoint.pending_query import encoding_of
from guidefield.errors import (
    GuidefieldError,
    MalformedRequest,
    NotAllowed,
    Preempted,
    QuotaExceeded,
    RequestTooLarge,
    ServerBusy,
    StreamUnknown,
)
from guidefield.messages import codec, stream_requests
from guidefield.messages.codec import Encoding
from guidefield.messages.identities import PLAIN, Asker, base_key, split_user
from guidefield.messages.keys import Query
from guidefield.messages.replies import Done
from guidefield.messages.stream_requests import StreamReply, StreamsReply
from guidefield.messages.streams import MOST_UPDATE_BYTES
from guidefield.pool.waiting import Answer
from guidefield.stores.files import checked_name
from guidefield.stream_worker import StreamConversation
from guidefield.worker import EngineSetup

RETRY_AFTER = 1.0  # time after which to ask again for a stream if all are taken [s]
ENDED_WITHIN = 5.0  # time for streams to end with the service [s]

_log = logging.getLogger(__name__)


class Streams:
    """The streams of a service."""

    def __init__(self, setup: EngineSetup, most: int, memory: int, publish: Publish) -> None:
        self._setup, self.most, self._memory, self._publish = setup, most, memory, publish
        self._counters = Counter(streams=0, updates=0, updates_astray=0)
        self._open: dict[tuple[str, str], OpenStream] = {}
        self._closed = False
        self._lock = threading.Lock()

    @property
    def open(self) -> int:
        """Return the number of open streams."""
        return len(self._open)

    @property
    def counters(self) -> dict[str, int]:
        """Return the numbers of streams opened, of updates, and of updates for no stream."""
        return dict(self._counters)

    @property
    def memory(self) -> int:
        """Resident memory of their processes [bytes]."""
        return sum(stream.memory for stream in self._all())

    def ask(self, read: Query) -> Future[Answer]:
        """Return the answer to come to a query; raises GuidefieldError if it is refused at once."""
        asked = stream_requests.decode_stream_query(read)
        if isinstance(asked, stream_requests.OpenStream):
            return self._open_stream(read, asked)
        if isinstance(asked, stream_requests.ListStreams):
            return _answer_now(self._list(read.owner), read.encoding)
        require_own(read)
        stream = self._named(read.owner, asked.name)
        if isinstance(asked, stream_requests.ReadStream):
            return _answer_now(stream.read(), read.encoding)
        if isinstance(asked, stream_requests.EndStream):
            answer: Future[Answer] = Future()
            done = True, codec.encode(Done(done=f"stream {asked.name!r} has ended"), read.encoding)
            over = stream.end(Preempted("it was asked to end", stream=asked.name))
            over.add_done_callback(lambda _: answer.set_result(done))
            return answer
        if isinstance(asked, stream_requests.HaltStream):
            return stream.ask("stop", read.encoding)
        assert isinstance(asked, stream_requests.AimStream | stream_requests.JudgeStream), "there is nothing else"
        return stream.ask(
            "aim" if isinstance(asked, stream_requests.AimStream) else "judge", read.encoding, read.payload
        )

    def update(self, key: str, payload: zenoh.ZBytes, encoding: object, allow: Callable[[str], None]) -> None:
        """Take an update; `allow` raises QuotaExceeded if its user sends too many."""
        self._counters["updates"] += 1
        try:
            user, chunks = split_user(key.split("/")[2:])
            stream = self._named(user, chunks[1])
        except (GuidefieldError, IndexError):  # no client hears of it
            self._counters["updates_astray"] += 1
            return
        try:
            allow(user)
            if len(payload) > MOST_UPDATE_BYTES:
                reason = f"the update has {len(payload)} bytes, at most {MOST_UPDATE_BYTES} are read"
                raise RequestTooLarge(reason, bytes=len(payload), limit=MOST_UPDATE_BYTES)
            stream.update(payload.to_bytes(), encoding_of(encoding))
        except GuidefieldError as error:
            stream.refuse(error)

    def forget(self, client: Asker) -> int:
        """End the streams of a client that is gone; return their number."""
        found = [stream for stream in self._all() if stream.asker == client]
        for stream in found:
            stream.end(Preempted("the client that opened it is gone"))
        return len(found)

    def close(self) -> None:
        """End all of them, and open no more."""
        with self._lock:
            self._closed = True
        for stream in self._all():
            stream.end(ServerBusy("the service is shutting down"))
        deadline = time.monotonic() + ENDED_WITHIN
        for stream in self._all():
            if not stream.join(deadline - time.monotonic()):
                _log.error("stream %s of %s didn't end", *reversed(stream.name))

    def _open_stream(self, read: Query, asked: stream_requests.OpenStream) -> Future[Answer]:
        request = asked.request
        if request.stream_id is None:
            request = msgspec.structs.replace(request, stream_id=uuid.uuid4().hex)
        name = checked_name(str(request.stream_id), "stream_id")
        own, words = (read.user, name), (read.encoding, read.payload)
        with self._lock:
            known = self._open.get(own)
            if known is None:
                self._require_room(read.user)
                conversation = StreamConversation(self._setup, read.user, request, read.encoding)
                base = f"{base_key(self._setup.instance, read.user)}/streams/{name}"
                known = self._open[own] = OpenStream(
                    own,
                    read.asker,
                    words,
                    conversation,
                    self._memory,
                    lambda key, payload, encoding: self._publish(f"{base}/{key}", payload, encoding),
                    self._forget_stream,
                )
                known.start()
                self._counters["streams"] += 1
            elif (known.asker, known.words) != (read.asker, words):
                raise MalformedRequest(f"`stream_id`: a stream {name!r} is open already", path="$.stream_id")
        answer: Future[Answer] = Future()

        def hand_on(opened: Future[StreamReply]) -> None:
            error = opened.exception()
            if error is not None:
                answer.set_exception(error)
            else:
                answer.set_result((True, codec.encode(opened.result(), read.encoding)))

        known.opened.add_done_callback(hand_on)
        return answer

    def _require_room(self, user: str) -> None:
        if self._closed:
            raise ServerBusy("the service is shutting down")
        if len(self._open) >= self.most:
            reason = f"{self.most} streams are open, and no more are taken (`--streams`); ask again later"
            raise ServerBusy(reason, streams=self.most, retry_after=RETRY_AFTER)
        quota = self._setup.quotas.of(user).streams
        if quota is not None and sum(one == user for one, _ in self._open) >= quota:
            reason = f"this user may have {quota} streams at once; end one"
            raise QuotaExceeded(reason, streams=quota, retry_after=RETRY_AFTER)

    def _forget_stream(self, stream: OpenStream) -> None:
        with self._lock:
            self._open.pop(stream.name, None)

    def _named(self, user: str, name: str) -> OpenStream:
        with self._lock:
            stream = self._open.get((user, name))
        if stream is None:
            raise StreamUnknown(f"no stream {name[:64]!r} is open", stream=name[:64])
        return stream

    def _all(self) -> list[OpenStream]:
        with self._lock:
            return list(self._open.values())

    def _list(self, user: str) -> StreamsReply:
        with self._lock:
            names = [name if own == user else f"{own}:{name}" for own, name in self._open if user in (own, PLAIN)]
        return StreamsReply(streams=sorted(names), most=self.most)


def require_own(read: Query) -> None:
    """Raise NotAllowed for a query about another user's stream, existing or not; `PLAIN`, an operator, may ask."""
    if read.user not in (read.owner, PLAIN):
        name = read.key[1][:64]
        reason = f"stream {name!r} belongs to user {read.owner!r}, who alone may use it"
        raise NotAllowed(reason, user=read.owner, stream=name)


def _answer_now(reply: msgspec.Struct, encoding: Encoding) -> Future[Answer]:
    answer: Future[Answer] = Future()
    answer.set_result((True, codec.encode(reply, encoding)))
    return answer
