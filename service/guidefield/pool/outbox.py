"""Answers on their way out: whoever doesn't read holds up nobody else.

Theory of operation. Zenoh sends an answer in the thread that gives it, and keeps that thread for seconds where a link
takes nothing more. So answers are given by threads that do nothing else. Those of one client are sent one after the
other; a client that doesn't read keeps one thread, until Zenoh ends its link. Of a client without a name each answer
counts as one's. What waits is bounded, for each client, each user and all.
One user has at most half of the threads and of the room.

The same threads attend to where answers come from, one at a time. That one sends what has come by itself: to wake
another thread for it takes longer than to send it. Where sending takes long after all, another one takes its place, and
for a while nothing is sent to that user by whoever attends.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import OrderedDict, deque
from collections.abc import Callable
from dataclasses import dataclass, field

from guidefield.messages.identities import Asker

MOST_THREADS = 128
"""How many answers may be sent at once."""
MOST_BYTES_OF_CLIENT = 64 * 2**20
"""What may wait for one client beside the answer that is sent to it [bytes]."""
MOST_BYTES = 2**30
"""What may wait for all of them [bytes]."""
MOST_LETTERS = 10_000
"""How many answers may wait."""
OF_USER = 0.5
"""Which share of the threads, bytes and answers one user may have."""
STALLED = 0.02
"""An answer that takes longer to send is no longer waited for by whoever attends to others [s]."""
SLOW_FOR = 5.0
"""How long answers to a user are left to other threads after that [s]."""
WATCHED_FOR = 1.0
"""How long after an answer it is still watched whether another one takes long [s]: nobody has to be woken for it."""
IDLE = 10.0
"""A thread that has had nothing to send for so long ends [s]."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class _Letter:
    size: int
    send: Callable[[], None]


_POLL = object(), _Letter(0, lambda: None)
"""In place of an answer to send: that it is a thread's turn to poll."""


@dataclass
class _Lane:
    """What waits for one client; whether one of it is being sent."""

    user: str
    letters: deque[_Letter] = field(default_factory=deque)
    size: int = 0
    busy: bool = False


@dataclass
class _Share:
    """What one user has: threads that send to its clients, answers that wait, and their size [bytes]."""

    threads: int = 0
    letters: int = 0
    size: int = 0

    def takes(self, size: int) -> bool:
        """Whether an answer of a size [bytes] may wait beside them."""
        return not self.letters or (self.letters < OF_USER * MOST_LETTERS and self.size + size <= OF_USER * MOST_BYTES)


class Outbox:
    """Sends answers in threads of its own.

    Args:
        poll: Waits until some answers have come, and posts them; called again and again, by one thread at a time.
    """

    def __init__(self, poll: Callable[[], None] | None = None) -> None:
        self._poll = poll
        self._polls = False
        self._polling: int | None = None
        self._sending: tuple[str, float] | None = None
        self._slow: dict[str, float] = {}
        self._sent_at = 0.0
        self._watched = threading.Event()
        self._lanes: dict[object, _Lane] = {}
        self._shares: dict[str, _Share] = {}
        self._ready: OrderedDict[str, deque[object]] = OrderedDict()
        self._size = self._count = self._threads = self._idle = 0
        self._lock = threading.RLock()
        self._sendable_now, self._emptied = threading.Condition(self._lock), threading.Condition(self._lock)
        self._closed = False

    def post(self, asker: Asker, size: int, send: Callable[[], None]) -> bool:
        """Have an answer sent, if not too much waits already.

        Args:
            asker: Who asked.
            size: Room that the answer takes [bytes].
            send: Sends it; may take as long as the client's link does.

        Returns:
            Whether it will be sent. One answer to a client always is.
        """
        with self._lock:
            key: object = asker if asker.client else object()
            lane = self._lanes.get(key)
            if lane is not None and lane.size + size > MOST_BYTES_OF_CLIENT:
                return False
            if not self._shares.get(asker.user, _Share()).takes(size):
                return False
            if self._count >= MOST_LETTERS or (self._count and self._size + size > MOST_BYTES):
                return False
            if lane is None:
                lane = self._lanes[key] = _Lane(asker.user)
            lane.letters.append(_Letter(size, send))
            lane.size += size
            share = self._shares.setdefault(asker.user, _Share())
            share.size += size
            share.letters += 1
            self._size += size
            self._count += 1
            if not lane.busy and len(lane.letters) == 1:
                self._be_ready(asker.user, key)
            return True

    def begin_polling(self) -> None:
        """Have a thread poll, from now on."""
        with self._lock:
            if self._poll is not None and not self._polls:
                self._polls = True
                self._have_taken()
                threading.Thread(target=self._watch, name="guidefield-outbox-watch", daemon=True).start()

    def end_polling(self, wake: Callable[[], None]) -> None:
        """Have no thread poll any more; `wake` ends the wait of the one that does."""
        with self._lock:
            self._polls = False
        wake()

    def close(self, within: float) -> None:
        """Send what waits, for so long [s]; then leave it."""
        deadline = time.monotonic() + within
        with self._lock:
            self._emptied.wait_for(lambda: not self._count, deadline - time.monotonic())
            if self._count:
                _log.warning("%d answers were not read and are left behind", self._count)
            self._closed = True
            self._sendable_now.notify_all()
        self._watched.set()

    def _be_ready(self, user: str, key: object) -> None:
        """Something may be sent to a client: have a thread do it, one that idles or a new one.

        One is woken, not all: where a hundred idled, they took longer to find nothing than an answer took.
        """
        self._ready.setdefault(user, deque()).append(key)
        if self._polling != threading.get_ident():  # that one looks when it has polled
            self._have_taken()

    def _have_taken(self) -> None:
        if self._idle:
            self._sendable_now.notify()
        else:
            self._start_thread()

    def _start_thread(self) -> None:
        if self._threads < MOST_THREADS + self._is_unpolled():  # whoever doesn't read keeps all from attending else
            self._threads += 1
            threading.Thread(target=self._send_all, name="guidefield-outbox", daemon=True).start()

    def _send_all(self) -> None:
        while (taken := self._next()) is not None:
            if taken is _POLL:
                self._poll_once()
                continue
            key, letter = taken
            try:
                letter.send()
            except Exception:  # the thread must outlive it, and there is nobody to tell
                _log.exception("an answer could not be sent")
            self._settle(key, letter)

    def _poll_once(self) -> None:
        assert self._poll is not None, "there is something to poll"
        try:
            self._poll()
        except Exception:
            _log.exception("answers could not be taken")

    def _next(self) -> tuple[object, _Letter] | None:
        """The next answer to send, or `_POLL`; None where there was neither for a while, or nothing is to be sent."""
        with self._lock:
            polls = self._polling == threading.get_ident()
            if polls and not self._polls:
                self._polling, polls = None, False
            if not polls:
                self._idle += 1
                found = self._sendable_now.wait_for(self._has_work, IDLE)
                self._idle -= 1
                if not found:
                    self._threads -= 1
                    return None
            user = self._sendable()
            if self._closed or (user is None and not polls and not self._is_unpolled()):
                self._threads -= 1
                return None
            if user is None:
                self._polling = threading.get_ident()
                return _POLL
            return self._taken_of(user, polls=polls)

    def _taken_of(self, user: str, *, polls: bool) -> tuple[object, _Letter]:
        """An answer to a user, which this thread will send; whether that one also `polls`."""
        keys = self._ready.pop(user)
        key = keys.popleft()
        if keys:
            self._ready[user] = keys  # at the end: every other user comes first
        self._shares[user].threads += 1
        lane = self._lanes[key]
        lane.busy = True
        if polls and self._slow.get(user, 0.0) < (now := time.monotonic()):
            self._sending, self._sent_at = (user, now), now
            if not self._watched.is_set():
                self._watched.set()
            return key, lane.letters.popleft()
        if polls:
            self._polling = None
        if self._is_unpolled() or (not self._idle and self._sendable() is not None):
            self._have_taken()  # it was told of more than it takes, and may be kept by whoever doesn't read
        return key, lane.letters.popleft()

    def _watch(self) -> None:
        """Have another thread poll where the one that does takes long to send something."""
        while not self._closed:
            self._watched.wait()
            time.sleep(STALLED)
            with self._lock:
                now = time.monotonic()
                if self._sending is not None and now - self._sending[1] > STALLED:
                    user, self._sending, self._polling = self._sending[0], None, None
                    self._slow = {name: until for name, until in self._slow.items() if until > now}
                    self._slow[user] = now + SLOW_FOR
                    self._have_taken()
                elif self._sending is None and now - self._sent_at > WATCHED_FOR and not self._closed:
                    self._watched.clear()

    def _has_work(self) -> bool:
        return self._closed or self._sendable() is not None or self._is_unpolled()

    def _is_unpolled(self) -> bool:
        return self._polls and self._polling is None

    def _sendable(self) -> str | None:
        """The first user to whose clients something may be sent: one that doesn't have too many threads."""
        most = OF_USER * MOST_THREADS
        return next((user for user in self._ready if self._shares[user].threads < most), None)

    def _settle(self, key: object, letter: _Letter) -> None:
        with self._lock:
            if self._polling == threading.get_ident():
                self._sending = None
            lane = self._lanes[key]
            lane.busy = False
            lane.size -= letter.size
            share = self._shares[lane.user]
            share.threads -= 1
            share.letters -= 1
            share.size -= letter.size
            if not share.letters:
                del self._shares[lane.user]
            self._size -= letter.size
            self._count -= 1
            if lane.letters:
                self._be_ready(lane.user, key)  # at the end: every other client comes first
            else:
                del self._lanes[key]
                if self._ready:
                    self._sendable_now.notify()  # somebody of the same user may have waited for this thread
            if not self._count:
                self._emptied.notify_all()
