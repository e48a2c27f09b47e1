"""The streams of a service: their opening, the queries and updates for them, and their end; each with its process.

Theory of operation. Each stream has a process for its life (`stream_worker.py`), whose messages `OpenStream` takes. Its
updates are put by the client, and can't be answered: the stream's key ``state`` tells their faults. Queries about it
are answered as all others. A stream belongs to its user; clients that can't use the user's keys can neither see nor
update it.
"""

from __future__ import annotations

import itertools
import logging
import threading
import time
import uuid
from collections import Counter
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, Literal

import msgspec
import zenoh

from guidefield import stream_worker
from guidefield.endpoint.under_way import encoding_of
from guidefield.engines import EngineSetup
from guidefield.errors import (
    GuidefieldError,
    MalformedRequest,
    NotAllowed,
    Preempted,
    QuotaExceeded,
    RequestTooLarge,
    ServerBusy,
    StreamUnknown,
    TimedOut,
)
from guidefield.messages import codec, stream_requests
from guidefield.messages.codec import Encoding
from guidefield.messages.identities import PLAIN, Asker, base_key, split_user
from guidefield.messages.keys import Query
from guidefield.messages.replies import Done, make_error
from guidefield.messages.stream_requests import StreamReply, StreamsReply
from guidefield.messages.streams import MOST_UPDATE_BYTES, StreamState
from guidefield.pool.process import Companion
from guidefield.pool.waiting import Answer
from guidefield.stores.files import checked_name
from guidefield.stream_worker import StreamConversation

SILENCE = 10.0  # time without an update after which a stream ends [s] (docs/stream.md)
OPENED_WITHIN = 120.0  # time for opening, which may prepare a robot [s]; below `ANSWER_TIMEOUT` (client/questions.py)
# both are in docs/wire.md by rules.py: after a change, `tools/wire_page`
Publish = Callable[[str, bytes, Encoding], None]  # publishes something on a key below the stream's


class OpenStream:
    """A stream with its process.

    Args:
        name: Its user, and its name.
        asker: The client that opens it; when that is gone, it ends.
        words: The query's encoding and payload: the same client may send it again after its link broke.
        conversation: The work of its process.
        memory: The limit of this process [bytes].
        publish: Publishes the messages of the process.
        left: Called when it is over.
    """

    def __init__(
        self,
        name: tuple[str, str],
        asker: Asker,
        words: tuple[Encoding, bytes],
        conversation: stream_worker.StreamConversation,
        memory: int,
        publish: Publish,
        left: Callable[[OpenStream], None],
    ) -> None:
        self.name, self.asker, self.words = name, asker, words
        self.opened: Future[StreamReply] = Future()
        self.opened.set_running_or_notify_cancel()
        self._finished: Future[None] = Future()
        self._encoding = conversation.encoding
        self._publish, self._left = publish, left
        self._queries: dict[int, Future[Answer]] = {}
        self._numbers = itertools.count(1)
        self._began = self._heard_at = time.monotonic()
        self._updates = self._pieces = 0
        self._executing = self._goal = 0  # numbers of the last piece and of the goal
        self._stops: float | None = None  # when the robot stops after that piece, by the client's clock [s]
        self._last: StreamState | None = None
        self._open: stream_worker.Open | None = None
        self._end: GuidefieldError | None = None
        self._gone = False
        self._lock = threading.Lock()
        self._companion = Companion(conversation, memory, self._hear, self._over, self._finish)

    def start(self) -> None:
        """Have it opened; the future `opened` says when it is."""
        self._companion.start()

    @property
    def memory(self) -> int:
        """Resident memory of its process [bytes]."""
        return self._companion.memory

    def update(self, payload: bytes, encoding: Encoding) -> None:
        """Take an update; if too many wait already, a state says so."""
        with self._lock:
            if self._open is None:
                return
            self._heard_at = time.monotonic()
            self._updates += 1
        if not self._companion.tell(stream_worker.Update(payload, encoding), len(payload)):
            self.refuse(ServerBusy("too many updates wait for this stream; send fewer", retry_after=1.0))

    def refuse(self, error: GuidefieldError) -> None:
        """Publish that an update isn't taken, and why."""
        with self._lock:
            state = self._last = stream_worker.make_state("refused", self._executing, self._stops or 0.0, error)
        self._publish("state", codec.encode(state, self._encoding), self._encoding)

    def ask(self, kind: Literal["aim", "judge", "stop"], encoding: Encoding, payload: bytes = b"") -> Future[Answer]:
        """Ask its process to aim for another goal, to judge its last piece, or to stop its robot.

        Raises StreamUnknown if it isn't open; ServerBusy if too many messages wait for it.
        """
        answer: Future[Answer] = Future()
        with self._lock:
            if self._open is None or self._gone or self._end is not None:
                raise StreamUnknown(f"stream {self.name[1]!r} isn't open", stream=self.name[1])
            number = next(self._numbers)
            self._queries[number] = answer
        if not self._companion.tell(stream_worker.StreamQuery(kind, number, encoding, payload), len(payload)):
            with self._lock:
                self._queries.pop(number, None)
            raise ServerBusy("too much waits for this stream already", retry_after=1.0)
        return answer

    def read(self) -> StreamReply:
        """Describe it; raises StreamUnknown if it isn't open yet."""
        with self._lock:
            return self._reply()

    def end(self, error: GuidefieldError) -> Future[None]:
        """End it soon, for a reason; the future says when it is over."""
        with self._lock:
            self._end = self._end or error
        return self._finished

    def join(self, timeout: float) -> bool:
        """Return whether it is over within a time [s]."""
        return self._companion.join(timeout)

    def _reply(self) -> StreamReply:
        known = self._open
        if known is None:
            raise StreamUnknown(f"stream {self.name[1]!r} is being opened", stream=self.name[1])
        return StreamReply(
            stream_id=self.name[1],
            robot=known.robot,
            position_names=list(known.position_names),
            start=list(known.start),
            goal=self._goal,
            executing=self._executing,
            stops=self._stops,
            updates=self._updates,
            pieces=self._pieces,
            silence=SILENCE,
            age=time.monotonic() - self._began,
            warnings=list(known.warnings),
            last=self._last,
        )

    def _hear(self, what: Any) -> None:
        if isinstance(what, stream_worker.Publication):
            with self._lock:
                self._executing, self._stops = what.executing, what.stops
                if what.state is None:
                    self._pieces += 1
                else:
                    self._last = what.state
            self._publish(what.key, what.payload, self._encoding)
        elif isinstance(what, stream_worker.QueryAnswer):
            with self._lock:
                answer = self._queries.pop(what.number)
                self._goal = what.goal
            answer.set_result((what.is_reply, what.payload))
        elif isinstance(what, stream_worker.Open):
            with self._lock:
                self._open, self._goal = what, what.goal
                self._heard_at = time.monotonic()
                reply = self._reply()
            self.opened.set_result(reply)
        elif isinstance(what, stream_worker.RefusedOpening):
            self.end(make_error(what.error))

    def _over(self) -> GuidefieldError | None:
        now = time.monotonic()
        with self._lock:
            if self._end is not None:
                return self._end
            if self._open is None and now - self._began > OPENED_WITHIN:
                return TimedOut(f"the stream wasn't open after {OPENED_WITHIN:g} s", seconds=OPENED_WITHIN)
            if self._open is not None and now - self._heard_at > SILENCE:
                return TimedOut(f"no update came for {SILENCE:g} s", seconds=SILENCE)
        return None

    def _finish(self, error: GuidefieldError) -> None:
        with self._lock:
            error = self._end or error
            self._gone = True
            queries, self._queries = list(self._queries.values()), {}
            was_open = self._open is not None
            state = self._last = stream_worker.make_state("ended", self._executing, self._stops or 0.0, error)
        self._left(self)
        if was_open:
            self._publish("state", codec.encode(state, self._encoding), self._encoding)
        else:
            self.opened.set_exception(error)
        for answer in queries:
            answer.set_exception(error)
        self._finished.set_result(None)


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
        query = stream_requests.decode_stream_query(read)
        if isinstance(query, stream_requests.OpenStream):
            return self._open_stream(read, query)
        if isinstance(query, stream_requests.ListStreams):
            return _answer_now(self._list(read.owner), read.encoding)
        require_own(read)
        stream = self._find_stream(read.owner, query.name)
        if isinstance(query, stream_requests.ReadStream):
            return _answer_now(stream.read(), read.encoding)
        if isinstance(query, stream_requests.EndStream):
            answer: Future[Answer] = Future()
            done = True, codec.encode(Done(done=f"stream {query.name!r} has ended"), read.encoding)
            over = stream.end(Preempted("it was asked to end", stream=query.name))
            over.add_done_callback(lambda _: answer.set_result(done))
            return answer
        if isinstance(query, stream_requests.HaltStream):
            return stream.ask("stop", read.encoding)
        assert isinstance(query, stream_requests.AimStream | stream_requests.JudgeStream), "there is nothing else"
        return stream.ask(
            "aim" if isinstance(query, stream_requests.AimStream) else "judge", read.encoding, read.payload
        )

    def update(self, key: str, payload: zenoh.ZBytes, encoding: object, allow: Callable[[str], None]) -> None:
        """Take an update; `allow` raises QuotaExceeded if its user sends too many."""
        self._counters["updates"] += 1
        try:
            user, chunks = split_user(key.split("/")[2:])
            stream = self._find_stream(user, chunks[1])
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

    def _open_stream(self, read: Query, query: stream_requests.OpenStream) -> Future[Answer]:
        request = query.request
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

    def _find_stream(self, user: str, name: str) -> OpenStream:
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
