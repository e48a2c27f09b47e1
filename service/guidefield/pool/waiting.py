"""The queue of jobs: bounded, fair between clients, searched for those whose time is up, closed at the end."""

from __future__ import annotations

import threading
from collections import OrderedDict, deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any

from guidefield.errors import ServerBusy

Answer = tuple[bool, bytes]
"""Whether it is a reply, or else an error; and the payload."""

BACKSTOP = 60.0
"""A worker that plans longer than its request allows by this is to be stopped [s]."""
LONGEST_WORK = 600.0
"""A worker that works longer on anything but a plan is to be stopped [s]."""


@dataclass(frozen=True)
class Deadline:
    """A time, by `time.monotonic()` [s], and what is answered then in a worker's place."""

    at: float
    answer: Callable[[], Answer]


def _hear_nothing(_told: bytes) -> None:
    pass


class Task(Future[Answer]):
    """A job that waits or is worked on, and the answer to come.

    Args:
        job: What the worker is given.
        seconds: A worker that works longer on it is stopped [s].
        deadline: When it need not be begun any more, if ever.
        late: When it is answered if it is begun and the worker still prepares for it; the worker goes on meanwhile.
        client: Who asks; the queue is fair between them.
        size: How much room the job takes while it waits [bytes].
        hear: Is called with what the worker tells while it works.
    """

    def __init__(
        self,
        job: Any,
        seconds: float,
        *,
        deadline: Deadline | None = None,
        late: Deadline | None = None,
        client: str = "",
        size: int = 0,
        hear: Callable[[bytes], None] = _hear_nothing,
    ) -> None:
        super().__init__()
        self.job = job
        self.seconds = seconds
        self.deadline = deadline
        self.late = late
        self.client = client
        self.size = size
        self.hear = hear
        self.cancelled_by_client = threading.Event()


@dataclass(frozen=True)
class Limits:
    """How much may wait.

    Attributes:
        tasks: How many tasks.
        tasks_of_client: How many of them one client may have.
        bytes: Room that all of them take.
        bytes_of_client: Room that those of one client take.
    """

    tasks: int = 64
    tasks_of_client: int = 64
    bytes: int = 1 << 30
    bytes_of_client: int = 1 << 28


class Waiting:
    """The queue: bounded, closed at the end; all slots take from it, from one client after the other."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._by_client: OrderedDict[str, deque[Task]] = OrderedDict()
        self._changed = threading.Condition()
        self.closed = False

    def __len__(self) -> int:
        with self._changed:
            return sum(len(tasks) for tasks in self._by_client.values())

    def put(self, task: Task) -> None:
        """Let a task wait its turn.

        Raises:
            ServerBusy: if too much waits already, of all clients or of this one, or the queue is closed.
        """
        with self._changed:
            if self.closed:
                raise ServerBusy("the service is shutting down")
            own = self._by_client.get(task.client, deque())
            for whose, tasks, most, most_bytes in (
                ("", list(self._all()), self._limits.tasks, self._limits.bytes),
                (" of this client", list(own), self._limits.tasks_of_client, self._limits.bytes_of_client),
            ):
                if len(tasks) >= most:
                    raise ServerBusy(
                        f"{len(tasks)} requests{whose} wait already; ask again later", queue=len(tasks), limit=most
                    )
                if tasks and sum(other.size for other in tasks) + task.size > most_bytes:
                    raise ServerBusy(
                        f"the requests{whose} that wait take up to {most_bytes} bytes already; ask again later",
                        bytes_limit=most_bytes,
                    )
            self._by_client.setdefault(task.client, deque()).append(task)
            self._changed.notify()

    def take(self, timeout: float) -> Task | None:
        """The next task; None if there is none within the time, or no more at all."""
        with self._changed:
            self._changed.wait_for(lambda: self._by_client or self.closed, timeout)
            if not self._by_client:
                return None
            client, tasks = self._by_client.popitem(last=False)
            task = tasks.popleft()
            if tasks:
                self._by_client[client] = tasks  # at the end: every other client comes first
            return task

    def take_expired(self, now: float) -> list[Task]:
        """Those tasks whose deadline has passed."""
        with self._changed:
            expired = [task for task in self._all() if task.deadline is not None and task.deadline.at < now]
            for task in expired:
                self._remove(task)
            return expired

    def withdraw(self, task: Task) -> bool:
        """Whether the task was waiting; it isn't any more."""
        with self._changed:
            waiting = task in self._by_client.get(task.client, ())
            if waiting:
                self._remove(task)
            return waiting

    def close(self) -> list[Task]:
        """Take no more; returns what waited."""
        with self._changed:
            self.closed = True
            left = list(self._all())
            self._by_client.clear()
            self._changed.notify_all()
            return left

    def _all(self) -> Iterator[Task]:
        return (task for tasks in self._by_client.values() for task in tasks)

    def _remove(self, task: Task) -> None:
        tasks = self._by_client[task.client]
        tasks.remove(task)
        if not tasks:
            del self._by_client[task.client]
