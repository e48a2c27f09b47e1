"""One stream of a service: its process (`stream_worker.py`), queries and updates for it, and their answers."""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, Literal

from guidefield import stream_worker
from guidefield.errors import GuidefieldError, ServerBusy, StreamUnknown, TimedOut
from guidefield.messages import codec
from guidefield.messages.codec import Encoding
from guidefield.messages.identities import Asker
from guidefield.messages.replies import make_error
from guidefield.messages.stream_requests import StreamReply
from guidefield.messages.streams import StreamState
from guidefield.pool.companion import Companion
from guidefield.pool.waiting import Answer

SILENCE = 10.0  # time without an update after which a stream ends [s]
OPENED_WITHIN = 120.0  # time after which opening is given up [s]; the first use of a robot prepares it
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
        self._companion = Companion(conversation, memory, self._hear, self._over, self._ended)

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
                answer = self._queries.pop(what.asked)
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

    def _ended(self, error: GuidefieldError) -> None:
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
