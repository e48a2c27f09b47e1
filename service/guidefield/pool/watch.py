"""Looks after one worker process from outside: whether it lives, and how much memory it has."""

from __future__ import annotations

import contextlib

import psutil

from guidefield.system import processor_time, resident


class Watch:
    """Looks after one worker process, a child of this one.

    Args:
        pid: Its id.
    """

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self._process = psutil.Process(pid)  # remembers when it began, so that it is told from a later one of its id

    def alive(self) -> bool:
        """Whether it runs; at once False when it has ended, however it did and whoever collects it."""
        try:
            return bool(self._process.is_running() and self._process.status() != psutil.STATUS_ZOMBIE)
        except psutil.NoSuchProcess:
            return False

    def memory(self) -> int:
        """Its resident memory [bytes]; 0 once it has ended."""
        return resident(self.pid)

    def processor(self) -> float:
        """How long processors worked on it [s]; 0 once it has ended."""
        return processor_time(self.pid)

    def kill(self) -> None:
        """End it at once; nothing else is hit, even if its id is used again."""
        with contextlib.suppress(psutil.NoSuchProcess):
            self._process.kill()
