"""Looks after one worker process from outside: whether it lives, and how much memory it has."""

from __future__ import annotations

import contextlib
import os
import select
import signal

from guidefield.resident import resident


class Watch:
    """Looks after one worker process, a child of this one.

    Args:
        pid: Its id.
    """

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self._descriptor = os.pidfd_open(pid)
        self._end = select.poll()
        self._end.register(self._descriptor, select.POLLIN)

    def alive(self) -> bool:
        """Whether it runs; at once False when it has ended, however it did and whoever collects it."""
        return not self._end.poll(0)

    def memory(self) -> int:
        """Its resident memory [bytes]; 0 once it has ended."""
        return resident(self.pid)

    def kill(self) -> None:
        """End it at once; nothing else can be hit, even if its id is used again."""
        with contextlib.suppress(ProcessLookupError, OSError):
            signal.pidfd_send_signal(self._descriptor, signal.SIGKILL)

    def close(self) -> None:
        """Look no more."""
        os.close(self._descriptor)
