"""Answers on their way out: a client that doesn't read holds up no other.

Theory of operation. Zenoh sends an answer in the thread that gives it, and blocks that thread for seconds if a link
takes no more. So answers are given by threads of their own, those of one client one after the other: a client that
doesn't read blocks one thread, until Zenoh ends its link. Each answer to a client without a name counts as a client's.
The answers that wait are bounded for each client, each user and all; one user has at most half of threads and space.

One more thread polls the workers, and sends the answers that it posts by itself: to wake another thread takes longer
than to send. If sending takes long after all, another thread polls instead, and for some seconds the polling
thread sends nothing to that user.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import OrderedDict, deque
from collections.abc import Callable
from dataclasses import dataclass, field

from guidefield.messages.identities import Asker

MOST_THREADS = 128  # maximum number of answers that are sent at once
MOST_BYTES_OF_CLIENT = 64 * 2**20  # maximum size of the answers that wait for one client [bytes]
MOST_BYTES = 2**30  # maximum size of the answers that wait for all clients [bytes]
MOST_LETTERS = 10_000  # maximum number of answers that wait
OF_USER = 0.5  # largest share of one user in threads, bytes and answers
STALLED = 0.02  # time to send an answer after which another thread polls [s]
SLOW_FOR = 5.0  # time for which other threads send the answers to that user then [s]
WATCHED_FOR = 1.0  # time for which the polling thread is still watched after an answer, so that none has to wake it [s]
IDLE = 10.0  # time without an answer after which a thread ends [s]

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class _Letter:
    size: int
    send: Callable[[], None]


@dataclass
class _Lane:
    """The letters that wait for one client; busy while one of them is sent, or will be by the thread that polls."""

    user: str
    letters: deque[_Letter] = field(default_factory=deque)
    size: int = 0
    busy: bool = False


@dataclass
class _Share:
    threads: int = 0
    letters: int = 0
    size: int = 0

    def takes(self, size: int) -> bool:
        return not self.letters or (self.letters < OF_USER * MOST_LETTERS and self.size + size <= OF_USER * MOST_BYTES)

    def may_send(self) -> bool:
        return self.threads < OF_USER * MOST_THREADS


class Outbox:
    """Sends answers in threads of its own.

    Args:
        poll: Waits for answers and posts them; called again and again, by one thread at a time.
    """

    def __init__(self, poll: Callable[[], None] = lambda: None) -> None:
        self._poll = poll
        self._polls = False
        self._poller: int | None = None
        self._own: deque[tuple[object, _Letter]] = deque()
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
        """Have an answer of a size [bytes] sent, which may take as long as the client's link does.

        Returns:
            False if too much waits already. One answer to a client is always sent.
        """
        user, key = asker.user, asker if asker.client else object()
        with self._lock:
            lane = self._lanes.get(key)
            if lane is not None and lane.size + size > MOST_BYTES_OF_CLIENT:
                return False
            share = self._shares.get(user) or _Share()
            is_full = self._count >= MOST_LETTERS or (self._count > 0 and self._size + size > MOST_BYTES)
            if is_full or not share.takes(size):
                return False
            if lane is None:
                lane = self._lanes[key] = _Lane(user)
            self._shares[user] = share
            self._add(lane, share, size, 1)
            letter = _Letter(size, send)
            if lane.busy or lane.letters:
                lane.letters.append(letter)
            elif self._poller == threading.get_ident() and share.may_send() and user not in self._slow:
                lane.busy = True
                share.threads += 1
                self._own.append((key, letter))
            else:
                lane.letters.append(letter)
                self._be_ready(user, key)
            return True

    def begin_polling(self) -> None:
        """Have a thread poll, from now on."""
        with self._lock:
            if not self._polls:
                self._polls = True
                _start(self._poll_all)
                _start(self._watch)

    def end_polling(self, wake: Callable[[], None]) -> None:
        """Have no thread poll any more; `wake` ends the wait of the one that does."""
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

    def _add(self, lane: _Lane, share: _Share, size: int, count: int) -> None:
        lane.size += size
        share.size += size
        share.letters += count
        self._size += size
        self._count += count

    def _be_ready(self, user: str, key: object) -> None:
        self._ready.setdefault(user, deque()).append(key)
        self._have_taken()

    def _have_taken(self) -> None:
        """Have one thread send an answer, an idle one or a new one; all that idle would take longer to find nothing."""
        if self._idle:
            self._sendable_now.notify()
        elif self._threads < MOST_THREADS:
            self._threads += 1
            _start(self._send_all)

    def _send_all(self) -> None:
        while (chosen := self._next()) is not None:
            self._send(*chosen)

    def _send(self, key: object, letter: _Letter) -> None:
        try:
            letter.send()
        except Exception:  # the thread must outlive it, and there is nobody to tell
            _log.exception("an answer could not be sent")
        with self._lock:
            self._settle(key, letter)

    def _next(self) -> tuple[object, _Letter] | None:
        """Return the next answer to send; None if there was none for `IDLE`, or the outbox is closed."""
        with self._lock:
            self._idle += 1
            self._sendable_now.wait_for(lambda: self._closed or self._sendable() is not None, IDLE)
            self._idle -= 1
            user = self._sendable()
            if self._closed or user is None:
                self._threads -= 1
                return None
            keys = self._ready.pop(user)
            key = keys.popleft()
            if keys:
                self._ready[user] = keys  # at the end: every other user comes first
            self._shares[user].threads += 1
            lane = self._lanes[key]
            lane.busy = True
            if not self._idle and self._sendable() is not None:
                self._have_taken()  # it was woken for more than it takes, and a client may block it
            return key, lane.letters.popleft()

    def _sendable(self) -> str | None:
        """The first user to whose clients something may be sent: one that doesn't have too many threads."""
        return next((user for user in self._ready if self._shares[user].may_send()), None)

    def _settle(self, key: object, letter: _Letter) -> None:
        lane = self._lanes[key]
        share = self._shares[lane.user]
        lane.busy = False
        share.threads -= 1
        self._add(lane, share, -letter.size, -1)
        if not share.letters:
            del self._shares[lane.user]
        if lane.letters:
            self._be_ready(lane.user, key)  # at the end: every other client comes first
        else:
            del self._lanes[key]
            if self._ready:
                self._sendable_now.notify()  # somebody of the same user may have waited for this thread
        if not self._count:
            self._emptied.notify_all()

    def _poll_all(self) -> None:
        """Poll, and send the answers that this posts, until another thread polls or none is to."""
        me = self._poller = threading.get_ident()
        while self._polls and self._poller == me:
            try:
                self._poll()
            except Exception:
                _log.exception("answers could not be taken")
            while (taken := self._next_own(me)) is not None:
                self._send(*taken)
        with self._lock:
            if self._poller == me:  # another thread may have its number later
                self._poller = None

    def _next_own(self, me: int) -> tuple[object, _Letter] | None:
        with self._lock:
            if self._poller != me:
                return None
            if not self._own:
                self._sending = None
                return None
            key, letter = self._own.popleft()
            self._sent_at = time.monotonic()
            self._sending = self._lanes[key].user, self._sent_at
            if not self._watched.is_set():
                self._watched.set()
            return key, letter

    def _watch(self) -> None:
        """Have another thread poll if the polling one takes long to send an answer."""
        while not self._closed:
            self._watched.wait()
            time.sleep(STALLED)
            with self._lock:
                now = time.monotonic()
                self._slow = {name: until for name, until in self._slow.items() if until > now}
                if self._sending is not None and now - self._sending[1] > STALLED:
                    self._slow[self._sending[0]] = now + SLOW_FOR
                    self._sending = self._poller = None
                    self._leave_own()
                    _start(self._poll_all)
                elif not (self._sending or self._slow or self._closed) and now - self._sent_at > WATCHED_FOR:
                    self._watched.clear()

    def _leave_own(self) -> None:
        while self._own:
            key, letter = self._own.popleft()
            lane = self._lanes[key]
            lane.busy = False
            lane.letters.appendleft(letter)
            self._shares[lane.user].threads -= 1
            self._be_ready(lane.user, key)


def _start(run: Callable[[], None]) -> None:
    threading.Thread(target=run, name="guidefield-outbox", daemon=True).start()
