"""What is owed after an answer: done by a thread of its own while nobody waits for an answer.

It never runs beside an answer: it is work in pieces, and an answer that is asked for meanwhile begins after the piece
that is being done. Where very much is owed, an answer waits until some of it is done.
"""

from __future__ import annotations

import contextlib
import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator

MOST_OWED = 8
"""With more owed than this no answer begins: what is owed holds the worlds that were planned in."""

REST = 0.01
"""How long after an answer nothing is begun, so that it goes out first [s]."""

Work = Callable[[Callable[[], None]], None]
"""Does what is owed; calls what it is given between its pieces."""

_log = logging.getLogger(__name__)


class Later:
    """Work that is owed, the oldest first."""

    def __init__(self) -> None:
        self._owed: deque[tuple[Work, Callable[[int], None]]] = deque()
        self._changed = threading.Condition()
        self._answering = self._doing = False
        self._since = 0.0
        self._thread = threading.Thread(target=self._run, name="guidefield-later", daemon=True)

    def add(self, work: Work, told: Callable[[int], None]) -> None:
        """Owe some work.

        Args:
            work: It; what it raises is logged.
            told: Told how much is owed, now and when it is done.
        """
        with self._changed:
            self._owed.append((work, told))
            told(len(self._owed))
            if self._thread.ident is None:
                self._thread.start()
            self._changed.notify_all()

    @contextlib.contextmanager
    def answering(self) -> Iterator[None]:
        """Answer somebody: nothing that is owed is done meanwhile."""
        with self._changed:
            self._changed.wait_for(lambda: len(self._owed) <= MOST_OWED)
            self._answering = True
            self._changed.wait_for(lambda: not self._doing)
        try:
            yield
        finally:
            with self._changed:
                self._answering, self._since = False, time.monotonic()
                self._changed.notify_all()

    def _pause(self) -> None:
        """Between two pieces of work."""
        with self._changed:
            self._doing = False
            self._changed.notify_all()
            self._wait_for_turn()

    def _wait_for_turn(self) -> None:
        while True:
            self._changed.wait_for(lambda: not self._answering)
            rest = self._since + REST - time.monotonic()
            if rest <= 0.0:
                break
            self._changed.wait(rest)
        self._doing = True

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._owed)
                self._wait_for_turn()
                work, told = self._owed[0]
            try:
                work(self._pause)
            except Exception:  # the thread outlives it
                _log.exception("what was owed after an answer failed")
            with self._changed:
                self._owed.popleft()
                self._doing = False
                told(len(self._owed))
                self._changed.notify_all()
            del work, told
