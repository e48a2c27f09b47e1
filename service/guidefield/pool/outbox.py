"""Send answers to clients in bounded queues and threads: a client that doesn't read delays no other.

Theory of operation. Zenoh sends an answer in the thread that gives it, and blocks that thread for seconds if a link
takes no more. So threads of their own send answers, those of one client one after the other: a client that doesn't read
blocks one thread, until Zenoh ends its link. Each answer to a client without a name has a queue of its own. The waiting
answers are bounded for each client, each user and all; one user has at most `USER_SHARE` of threads and space.

One more thread polls the workers (`pool.py`), and sends the answers that it posts itself, since waking another thread
takes longer than sending. If sending takes longer than `STALL_TIME_S`, another thread polls instead, and for
`SLOW_USER_S` the polling thread sends nothing to that user. The service and docs/wire.md list the limits of bytes and
answers, and `USER_SHARE` (`endpoint/rules.py`): after a change, `tools/wire_page`.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import OrderedDict, deque
from collections.abc import Callable
from dataclasses import dataclass, field

from guidefield.messages.identities import Asker

MAX_THREADS = 128  # maximum number of answers that are sent at once; `endpoint/link.py` gives Zenoh four more
MAX_CLIENT_BYTES = 64 * 2**20  # maximum size of the answers that wait for one client [bytes]
MAX_UNREAD_BYTES = 2**30  # maximum size of the answers that wait for all clients [bytes]
MAX_ANSWERS = 10_000  # maximum number of answers that wait
USER_SHARE = 0.5  # largest share of one user in threads, bytes and answers
STALL_TIME_S = 0.02  # time to send an answer after which another thread polls [s]
SLOW_USER_S = 5.0  # time for which other threads send the answers to that user then [s]
WATCH_TIME_S = 1.0  # time after an answer for which the watching thread goes on, so that the next needn't wake it [s]
IDLE_TIME_S = 10.0  # time without an answer after which a thread ends [s]

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class _OutgoingAnswer:
    size: int
    send: Callable[[], None]


@dataclass
class _ClientQueue:
    """The answers that wait for one client; busy while one of them is sent, or will be by the thread that polls."""

    user: str
    answers: deque[_OutgoingAnswer] = field(default_factory=deque)
    size: int = 0
    busy: bool = False


@dataclass
class _UserLoad:
    """Threads that send to a user's clients, and the number and size of that user's answers, waiting or being sent."""

    threads: int = 0
    answers: int = 0
    size: int = 0

    def has_room(self, size: int) -> bool:
        is_small = self.answers < USER_SHARE * MAX_ANSWERS and self.size + size <= USER_SHARE * MAX_UNREAD_BYTES
        return not self.answers or is_small

    def may_send(self) -> bool:
        return self.threads < USER_SHARE * MAX_THREADS


class Outbox:
    """Sends answers in threads of its own.

    Args:
        poll: Waits for answers and posts them; called again and again, by one thread at a time.
    """

    def __init__(self, poll: Callable[[], None] = lambda: None) -> None:
        self._poll = poll
        self._polls = False
        self._poller: int | None = None  # the polling thread
        self._own: deque[tuple[object, _OutgoingAnswer]] = deque()  # answers that it sends itself
        self._sending: tuple[str, float] | None = None  # the user it sends to, and since when
        self._slow: dict[str, float] = {}  # users it sends nothing to, and until when
        self._sent_at = 0.0
        self._watched = threading.Event()
        self._queues: dict[object, _ClientQueue] = {}
        self._loads: dict[str, _UserLoad] = {}
        self._ready: OrderedDict[str, deque[object]] = OrderedDict()  # clients with answers to send, by user
        self._size = self._count = self._threads = self._idle = 0
        self._lock = threading.RLock()
        self._sendable_now, self._emptied = threading.Condition(self._lock), threading.Condition(self._lock)
        self._closed = False

    def post(self, asker: Asker, size: int, send: Callable[[], None]) -> bool:
        """Have an answer of a size [bytes] sent, which may take as long as the client's link does.

        Returns:
            False if too much waits already. One answer to a client is never too large for that client.
        """
        user, key = asker.user, asker if asker.client else object()
        with self._lock:
            queue = self._queues.get(key)
            if queue is not None and queue.size + size > MAX_CLIENT_BYTES:
                return False
            load = self._loads.get(user) or _UserLoad()
            is_full = self._count >= MAX_ANSWERS or (self._count > 0 and self._size + size > MAX_UNREAD_BYTES)
            if is_full or not load.has_room(size):
                return False
            if queue is None:
                queue = self._queues[key] = _ClientQueue(user)
            self._loads[user] = load
            self._add(queue, load, size, 1)
            answer = _OutgoingAnswer(size, send)
            if queue.busy or queue.answers:
                queue.answers.append(answer)
            elif self._poller == threading.get_ident() and load.may_send() and user not in self._slow:
                queue.busy = True
                load.threads += 1
                self._own.append((key, answer))
            else:
                queue.answers.append(answer)
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

    def _add(self, queue: _ClientQueue, load: _UserLoad, size: int, count: int) -> None:
        queue.size += size
        load.size += size
        load.answers += count
        self._size += size
        self._count += count

    def _be_ready(self, user: str, key: object) -> None:
        self._ready.setdefault(user, deque()).append(key)
        self._have_taken()

    def _have_taken(self) -> None:
        """Wake one idle thread, or start one, to send an answer; waking all would take longer."""
        if self._idle:
            self._sendable_now.notify()
        elif self._threads < MAX_THREADS:
            self._threads += 1
            _start(self._send_all)

    def _send_all(self) -> None:
        while (chosen := self._next()) is not None:
            self._send(*chosen)

    def _send(self, key: object, answer: _OutgoingAnswer) -> None:
        try:
            answer.send()
        except Exception:  # the thread must outlive it, and there is nobody to tell
            _log.exception("an answer could not be sent")
        with self._lock:
            self._settle(key, answer)

    def _next(self) -> tuple[object, _OutgoingAnswer] | None:
        """Return the next answer to send; None if there was none for `IDLE_TIME_S`, or the outbox is closed."""
        with self._lock:
            self._idle += 1
            self._sendable_now.wait_for(lambda: self._closed or self._sendable() is not None, IDLE_TIME_S)
            self._idle -= 1
            user = self._sendable()
            if self._closed or user is None:
                self._threads -= 1
                return None
            keys = self._ready.pop(user)
            key = keys.popleft()
            if keys:
                self._ready[user] = keys  # at the end: every other user comes first
            self._loads[user].threads += 1
            queue = self._queues[key]
            queue.busy = True
            if not self._idle and self._sendable() is not None:
                self._have_taken()  # it was woken for more than it takes, and a client may block it
            return key, queue.answers.popleft()

    def _sendable(self) -> str | None:
        """Return the first user with answers to send who doesn't have too many threads."""
        return next((user for user in self._ready if self._loads[user].may_send()), None)

    def _settle(self, key: object, answer: _OutgoingAnswer) -> None:
        queue = self._queues[key]
        load = self._loads[queue.user]
        queue.busy = False
        load.threads -= 1
        self._add(queue, load, -answer.size, -1)
        if not load.answers:
            del self._loads[queue.user]
        if queue.answers:
            self._be_ready(queue.user, key)  # at the end: every other client comes first
        else:
            del self._queues[key]
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

    def _next_own(self, me: int) -> tuple[object, _OutgoingAnswer] | None:
        with self._lock:
            if self._poller != me:
                return None
            if not self._own:
                self._sending = None
                return None
            key, answer = self._own.popleft()
            self._sent_at = time.monotonic()
            self._sending = self._queues[key].user, self._sent_at
            if not self._watched.is_set():
                self._watched.set()
            return key, answer

    def _watch(self) -> None:
        """Have another thread poll if the polling one takes long to send an answer."""
        while not self._closed:
            self._watched.wait()
            time.sleep(STALL_TIME_S)
            with self._lock:
                now = time.monotonic()
                self._slow = {name: until for name, until in self._slow.items() if until > now}
                if self._sending is not None and now - self._sending[1] > STALL_TIME_S:
                    self._slow[self._sending[0]] = now + SLOW_USER_S
                    self._sending = self._poller = None
                    self._leave_own()
                    _start(self._poll_all)
                elif not (self._sending or self._slow or self._closed) and now - self._sent_at > WATCH_TIME_S:
                    self._watched.clear()

    def _leave_own(self) -> None:
        while self._own:
            key, answer = self._own.popleft()
            queue = self._queues[key]
            queue.busy = False
            queue.answers.appendleft(answer)
            self._loads[queue.user].threads -= 1
            self._be_ready(queue.user, key)


def _start(run: Callable[[], None]) -> None:
    threading.Thread(target=run, name="guidefield-outbox", daemon=True).start()
