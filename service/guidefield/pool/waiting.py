"""The queue of jobs: bounded, searched for those whose time is up, closed at the end."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any

from guidefield.errors import ServerBusy

Answer = tuple[bool, bytes]
"""Whether it is a reply, or else an error; and the payload."""


@dataclass(frozen=True)
class Deadline:
    """When a job that still waits need not be begun any more, by `time.monotonic()`; and what is answered then."""

    at: float
    answer: Callable[[], Answer]


@dataclass(frozen=True, eq=False)
class Task:
    """A job that waits or is worked on [s], and the answer to come."""

    job: Any
    seconds: float
    deadline: Deadline | None
    future: Future[Answer] = field(default_factory=Future)


class Waiting:
    """The queue: bounded, closed at the end; all slots take from it."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._tasks: deque[Task] = deque()
        self._changed = threading.Condition()
        self.closed = False

    def __len__(self) -> int:
        return len(self._tasks)

    def put(self, task: Task) -> None:
        """Let a task wait its turn.

        Raises:
            ServerBusy: if too many wait already, or the queue is closed.
        """
        with self._changed:
            if self.closed:
                raise ServerBusy("the service is shutting down", queue=len(self._tasks), limit=self._limit)
            if len(self._tasks) >= self._limit:
                raise ServerBusy(
                    f"{len(self._tasks)} requests wait already; ask again later",
                    queue=len(self._tasks),
                    limit=self._limit,
                )
            self._tasks.append(task)
            self._changed.notify()

    def take(self, timeout: float) -> Task | None:
        """The next task; None if there is none within the time, or no more at all."""
        with self._changed:
            self._changed.wait_for(lambda: self._tasks or self.closed, timeout)
            return self._tasks.popleft() if self._tasks else None

    def take_expired(self, now: float) -> list[Task]:
        """Those tasks whose deadline has passed."""
        with self._changed:
            expired = [task for task in self._tasks if task.deadline is not None and task.deadline.at < now]
            for task in expired:
                self._tasks.remove(task)
            return expired

    def close(self) -> list[Task]:
        """Take no more; returns what waited."""
        with self._changed:
            self.closed = True
            left = list(self._tasks)
            self._tasks.clear()
            self._changed.notify_all()
            return left
