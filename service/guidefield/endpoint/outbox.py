"""Answers on their way out: whoever doesn't read holds up nobody else.

Theory of operation. Zenoh sends an answer in the thread that gives it, and keeps that thread for seconds where a link
takes nothing more. So answers are given by threads that do nothing else. Those of one client are sent one after the
other; a client that doesn't read keeps one thread, until Zenoh ends its link. Of a client without a name each answer
counts as one's. What waits is bounded, for each client and for all.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

MOST_THREADS = 128
"""How many answers may be sent at once."""
MOST_BYTES_OF_CLIENT = 64 * 2**20
"""What may wait for one client beside the answer that is sent to it [bytes]."""
MOST_BYTES = 2**30
"""What may wait for all of them [bytes]."""
MOST_LETTERS = 10_000
"""How many answers may wait."""
IDLE = 10.0
"""A thread that has had nothing to send for so long ends [s]."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class _Letter:
    size: int
    send: Callable[[], None]


@dataclass
class _Lane:
    """What waits for one client; whether one of it is being sent."""

    letters: deque[_Letter] = field(default_factory=deque)
    size: int = 0
    busy: bool = False


class Outbox:
    """Sends answers in threads of its own."""

    def __init__(self) -> None:
        self._lanes: dict[object, _Lane] = {}
        self._ready: deque[object] = deque()
        self._size = self._count = self._threads = self._idle = 0
        self._changed = threading.Condition()
        self._closed = False

    def post(self, client: str, size: int, send: Callable[[], None]) -> bool:
        """Have an answer sent, if not too much waits already.

        Args:
            client: Who asked; empty: somebody without a name.
            size: Room that the answer takes [bytes].
            send: Sends it; may take as long as the client's link does.

        Returns:
            Whether it will be sent. One answer to a client always is.
        """
        with self._changed:
            key: object = client or object()
            lane = self._lanes.get(key)
            if lane is not None and lane.size + size > MOST_BYTES_OF_CLIENT:
                return False
            if self._count >= MOST_LETTERS or (self._count and self._size + size > MOST_BYTES):
                return False
            if lane is None:
                lane = self._lanes[key] = _Lane()
            lane.letters.append(_Letter(size, send))
            lane.size += size
            self._size += size
            self._count += 1
            if not lane.busy and len(lane.letters) == 1:
                self._ready.append(key)
                self._wake()
            return True

    def close(self, within: float) -> None:
        """Send what waits, for so long [s]; then leave it."""
        deadline = time.monotonic() + within
        with self._changed:
            self._changed.wait_for(lambda: not self._count, deadline - time.monotonic())
            if self._count:
                _log.warning("%d answers were not read and are left behind", self._count)
            self._closed = True
            self._changed.notify_all()

    def _wake(self) -> None:
        """Have a thread send what is ready: one that idles, or a new one."""
        if self._idle >= len(self._ready):
            self._changed.notify_all()
        elif self._threads < MOST_THREADS:
            self._threads += 1
            threading.Thread(target=self._send_all, name="guidefield-outbox", daemon=True).start()

    def _send_all(self) -> None:
        while (taken := self._next()) is not None:
            key, letter = taken
            try:
                letter.send()
            except Exception:  # the thread must outlive it, and there is nobody to tell
                _log.exception("an answer could not be sent")
            self._sent(key, letter)

    def _next(self) -> tuple[object, _Letter] | None:
        """The next answer to send; None where there was none for a while, or nothing more is to be sent."""
        with self._changed:
            self._idle += 1
            self._changed.wait_for(lambda: self._ready or self._closed, IDLE)
            self._idle -= 1
            if self._closed or not self._ready:
                self._threads -= 1
                return None
            key = self._ready.popleft()
            lane = self._lanes[key]
            lane.busy = True
            return key, lane.letters.popleft()

    def _sent(self, key: object, letter: _Letter) -> None:
        with self._changed:
            lane = self._lanes[key]
            lane.busy = False
            lane.size -= letter.size
            self._size -= letter.size
            self._count -= 1
            if lane.letters:
                self._ready.append(key)  # at the end: every other client comes first
                self._wake()
            else:
                del self._lanes[key]
            if not self._count:
                self._changed.notify_all()
