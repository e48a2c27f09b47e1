"""The queue of jobs: bounded, fair between users and their clients (start-time fair queueing), closed at the end.

Theory of operation. A free worker goes to the user who has the fewest workers; of equal users, to the one whose turn it
is by start-time fair queueing (Goyal, Vin and Cheng, 1996): a user's turn moves on by the processor time that it got,
and a user without tasks that wait begins where the queue is. Of equal turns the user with the fewest tasks comes first.
So a user of few requests waits for one free worker at most, however many others wait. The clients of one user
take turns. If the queue is full, a user with fewer tasks in it pushes out the last task of the user with the most.

Long requests may occupy all workers when another user comes. So one more worker stands by: it takes only tasks that
have waited for `STANDBY_WAIT_S`, of users who have no worker. If it works on one for longer than `TRIAL_S` while
another such user waits, the task goes back to the head of its user's row, to begin anew; each time, it must wait twice
as long until it takes another one's place. So every task of some seconds ends; the first to come never waits longer.
"""

from __future__ import annotations

import math
import threading
import time
from collections import Counter, OrderedDict, deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from guidefield.errors import ServerBusy
from guidefield.messages.identities import ANONYMOUS, Asker

Answer = tuple[bool, bytes]  # true for a reply, False for an error; and the payload
LONGEST_WORK = 600.0  # a worker of a batch, which may prepare a robot first, is stopped after that at the earliest [s]
BACKSTOP = 60.0  # a worker that works longer than its request allows by this is stopped [s]
STANDBY_WAIT_S = 0.4  # wait of a user without a worker, after which the worker that stands by takes its task [s]
TRIAL_S = 0.4  # time for which that one works on a task before another user's may take its place [s]
# the last three are in docs/wire.md by endpoint/rules.py: after a change, `tools/wire_page`. `BACKSTOP` is also in
# docs/service.md, where the others together stay below a second; it is less than the margins in client/questions.py
MIN_RETRY_S, MAX_RETRY_S = 0.1, 30.0  # bounds of the time after which a client is asked to come back [s]
HALF_LIFE_S = 30.0
"""Half-life of a user's use of processors [s], which quotas count: `endpoint/allowances.py`.

`UserFigures` of `messages/service.py` and docs/operation.md tell it.
"""
NEGLIGIBLE_USE_S = 1e-3  # use of processors that counts as none [s]
MAX_USERS = 100  # number of users above which those without use are removed
NEWEST_WEIGHT = 0.1  # weight of the newest request in the typical time of one


class TimedAnswer(NamedTuple):
    """A time, by `time.monotonic()` [s], and the answer then in a worker's place."""

    at: float  # the time
    answer: Callable[[], Answer]  # makes the answer
    at_last: float = math.inf  # the same for a worker that is done preparing, and checks its deadline itself


def _ignore(*_: bytes) -> None:
    pass


class Task(Future[Answer]):
    """A job that waits or is worked on, and the answer to come.

    Args:
        seconds: A worker that works longer on it is stopped [s].
        deadline: Its answer if it still waits then, and when that is.
        late: Its answer if the worker is late with it, and when that is; the worker continues.
        asker: Its user and client.
        size: Memory of the job while it waits [bytes].
        hear: Is called with what the worker tells while it works.
        begin: Is called when a worker begins with it, and again when one begins anew.
        end_late: Is called when a worker has ended with it after it was answered in the worker's place.
        is_brief: Whether it will most likely take milliseconds, and may be done twice: a worker may hold it while it
            works on another one.

    Attributes:
        since: When it began to wait, by `time.monotonic()` [s].
        set_back: How often it was begun and gave way to another one.
        handed: How often it was handed to a worker that ended.
        is_overdue: Whether its answer stands in for a worker's that didn't come in time.
        cancelled_by_client: Whether its client cancelled it; `if_cancelled` makes its answer then.
    """

    def __init__(
        self,
        job: Any,
        seconds: float,
        *,
        deadline: TimedAnswer | None = None,
        late: TimedAnswer | None = None,
        asker: Asker = ANONYMOUS,
        size: int = 0,
        hear: Callable[[bytes], None] = _ignore,
        begin: Callable[[], None] = _ignore,
        end_late: Callable[[], None] = _ignore,
        is_brief: bool = False,
    ) -> None:
        super().__init__()
        self.job, self.seconds, self.deadline, self.late = job, seconds, deadline, late
        self.asker, self.size, self.is_brief = asker, size, is_brief
        self.hear, self.begin, self.end_late = hear, begin, end_late
        self.cancelled_by_client = self.is_overdue = False
        self.if_cancelled: Callable[[], Answer] | None = None
        self.since = time.monotonic()
        self.set_back = self.handed = 0

    def end_overdue(self, deadline: TimedAnswer) -> None:
        """Answer it because a time is up."""
        self.is_overdue = True
        self.set_result(deadline.answer())


@dataclass(frozen=True)
class Limits:
    """Limits of the queue, of all clients and of one; for docs/wire.md, `tools/wire_page`."""

    tasks: int = 64  # a service's: `limits_of` in endpoint/service.py
    tasks_of_client: int = 64  # likewise
    bytes: int = 1 << 30
    bytes_of_client: int = 1 << 28


@dataclass
class _UserTasks:
    """The tasks of one user that wait, in a row for each client; the clients take turns."""

    rows: OrderedDict[str, deque[Task]] = field(default_factory=OrderedDict)
    count: int = 0
    size: int = 0

    def add(self, task: Task, *, first: bool) -> None:
        row = self.rows.setdefault(task.asker.client, deque())
        if first:
            row.appendleft(task)
            self.rows.move_to_end(task.asker.client, last=False)
        else:
            row.append(task)
        self.count += 1
        self.size += task.size

    def next(self) -> Task:
        return next(iter(self.rows.values()))[0]

    def remove(self, task: Task) -> None:
        row = self.rows[task.asker.client]
        row.remove(task)
        if not row:
            del self.rows[task.asker.client]
        self.count -= 1
        self.size -= task.size


class Waiting:
    """The queue; the caller of `take` calls `settle` later. Safe for threads, none of which waits in it.

    Attributes:
        due_at: Latest time to call `take_expired`, by `time.monotonic()` [s]; infinite: no task with a deadline waits.
    """

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._lines: OrderedDict[str, _UserTasks] = OrderedDict()
        self._count = self._size = 0
        self._running: Counter[str] = Counter()
        self._typical = 1.0  # mean time of a request lately [s]
        self._used: dict[str, tuple[float, float]] = {}  # a user's use of processors, and when it was that [s]
        self._turns: dict[str, float] = {}  # a user's turn: the start tag of fair queueing, in processor time [s]
        self._turn = 0.0  # turn of the user who was served last
        self._lock = threading.Lock()
        self.closed = False
        self.due_at = math.inf

    def __len__(self) -> int:
        return self._count

    def of_user(self, user: str) -> int:
        """Return the number of a user's tasks that wait."""
        with self._lock:
            return self._lines[user].count if user in self._lines else 0

    def running(self, user: str) -> int:
        """Return the number of a user's tasks that are worked on."""
        return self._running.get(user, 0)

    def users(self) -> set[str]:
        """Return the users who have tasks that wait or are worked on, or had some lately."""
        with self._lock:
            return {*self._lines, *self._running, *self._forget_unused(time.monotonic())}

    def used(self, user: str) -> float:
        """Return the processor time that a user got lately, halved every `HALF_LIFE_S` [s]."""
        return self._used_by(user, time.monotonic())

    def retry_after(self, user: str) -> float:
        """Estimate the time until half of a user's waiting tasks are done [s]."""
        line = self._lines.get(user)
        waits = 0.5 * (line.count if line is not None else 1) * self._typical
        return round(min(max(waits, MIN_RETRY_S), MAX_RETRY_S), 2)

    def add(self, task: Task) -> list[Task]:
        """Let a task wait its turn; return tasks of users who have more waiting that were pushed out for it.

        Raises ServerBusy if too much waits already, of all clients or of this one, or the queue is closed.
        """
        with self._lock:
            if self.closed:
                raise ServerBusy("the service is shutting down")
            line = self._lines.get(task.asker.user) or _UserTasks()
            if (row := line.rows.get(task.asker.client)) is not None:
                self._require_room_for_client(row, task)
            pushed: list[Task] = []
            while (refusal := self._full(task)) is not None:
                if (longest := self._longer_than(line, task)) is None:
                    for other in pushed:  # they took less memory than was needed
                        self._add(other)
                    raise refusal
                pushed.append(max(longest.rows.values(), key=len)[-1])
                self._remove(pushed[-1])
            self._add(task)
            return pushed

    def take(self, *, brief: bool = False) -> Task | None:
        """Take the next task, if there is one and, if `brief`, it is a brief one; `settle` must follow."""
        with self._lock:
            if not self._count:
                return None
            user = next(iter(self._lines)) if len(self._lines) == 1 else min(self._lines, key=self._order)
            if brief and not self._lines[user].next().is_brief:
                return None
            return self._take_of(user)

    def take_held_up(self, now: float) -> Task | None:
        """Take the next task of a user without a worker that waited for `STANDBY_WAIT_S`; no other worker is free."""
        with self._lock:
            user = self._held_up(now)
            return None if user is None else self._take_of(user)

    def is_held_up(self, worked: float) -> bool:
        """Return whether a user is held up who may take the place of a task that took some time [s]."""
        with self._lock:
            return self._held_up(time.monotonic(), worked) is not None

    def put_back(self, task: Task, *, gave_way: bool = True) -> bool:
        """Let a task that was taken wait again, before all others of its user; return False if it was cancelled.

        `gave_way`: it was begun, and made room for another one. Raises ServerBusy if the queue is closed.
        """
        with self._lock:
            if self.closed:
                raise ServerBusy("the service is shutting down")
            if task.cancelled_by_client:
                return False
            task.set_back += gave_way
            self._add(task, first=True)
            return True

    def settle(self, task: Task, seconds: float, processor: float) -> None:
        """Note that a task that was taken is done, after some time, with some use of the processors [s]."""
        with self._lock:
            user, now = task.asker.user, time.monotonic()
            self._running[user] -= 1
            if not self._running[user]:
                del self._running[user]
            self._typical += NEWEST_WEIGHT * (seconds - self._typical)
            self._used[user] = self._used_by(user, now) + processor, now
            if len(self._used) > MAX_USERS:
                self._used = self._forget_unused(now)
            self._turns[user] = self._turns.get(user, self._turn) + processor
            if len(self._turns) > MAX_USERS:
                here = self._lines.keys() | self._running.keys()
                self._turns = {name: turn for name, turn in self._turns.items() if turn > self._turn or name in here}

    def take_expired(self, now: float) -> list[Task]:
        """Remove the tasks whose deadline has passed, and return them."""
        with self._lock:
            with_deadline = [(task.deadline.at, task) for task in self._all() if task.deadline is not None]
            expired = [task for at, task in with_deadline if at <= now]
            for task in expired:
                self._remove(task)
            self.due_at = min((at for at, _ in with_deadline if at > now), default=math.inf)
            return expired

    def withdraw(self, task: Task) -> bool:
        """Remove a task from the queue; return whether it was there."""
        with self._lock:
            line = self._lines.get(task.asker.user)
            is_waiting = line is not None and task in line.rows.get(task.asker.client, ())
            if is_waiting:
                self._remove(task)
            return is_waiting

    def close(self) -> list[Task]:
        """Take no more; return what waited."""
        with self._lock:
            self.closed = True
            left = list(self._all())
            self._lines.clear()
            self._count = self._size = 0
            return left

    def _require_room_for_client(self, row: deque[Task], task: Task) -> None:
        most, most_bytes = self._limits.tasks_of_client, self._limits.bytes_of_client
        if len(row) >= most:
            raise self._busy(f"{len(row)} requests of this client wait already", task, queue=len(row), limit=most)
        if sum(other.size for other in row) + task.size > most_bytes:
            reason = f"the requests of this client that wait take up to {most_bytes} bytes already"
            raise self._busy(reason, task, bytes_limit=most_bytes)

    def _full(self, task: Task) -> ServerBusy | None:
        most, most_bytes, count = self._limits.tasks, self._limits.bytes, self._count
        if count >= most:
            return self._busy(f"{count} requests wait already", task, queue=count, limit=most)
        if count and self._size + task.size > most_bytes:
            reason = f"the requests that wait take up to {most_bytes} bytes already"
            return self._busy(reason, task, bytes_limit=most_bytes)
        return None

    def _busy(self, reason: str, task: Task, **details: Any) -> ServerBusy:
        return ServerBusy(f"{reason}; ask again later", **details, retry_after=self.retry_after(task.asker.user))

    def _longer_than(self, line: _UserTasks, task: Task) -> _UserTasks | None:
        """Return the line of another user that has the most waiting, if that is more than this one will have."""
        count, size = self._limits.tasks, self._limits.bytes

        def share(other: _UserTasks, more: int = 0, more_bytes: int = 0) -> float:
            return max((other.count + more) / count, (other.size + more_bytes) / size)

        longest = max((other for other in self._lines.values() if other is not line), key=share, default=None)
        return longest if longest is not None and share(longest) > share(line, 1, task.size) else None

    def _add(self, task: Task, *, first: bool = False) -> None:
        user = task.asker.user
        if (line := self._lines.get(user)) is None:  # its turn comes at the earliest after those that were served
            self._turns[user] = max(self._turns.get(user, 0.0), self._turn)
            line = self._lines[user] = _UserTasks()
        line.add(task, first=first)
        if task.deadline is not None:
            self.due_at = min(self.due_at, task.deadline.at)
        self._count += 1
        self._size += task.size

    def _order(self, user: str) -> tuple[int, float, int]:
        """Return the order of a user among those who wait: the least is served first."""
        return self._running[user], self._turns[user], self._lines[user].count

    def _take_of(self, user: str) -> Task:
        self._turn = max(self._turn, self._turns[user])
        line = self._lines[user]
        task = line.next()
        self._remove(task)
        if task.asker.client in line.rows:
            line.rows.move_to_end(task.asker.client)  # every other client comes first
        if line.count:
            self._lines.move_to_end(user)  # of users who are equal every other one comes first
        self._running[user] += 1
        return task

    def _held_up(self, now: float, worked: float = math.inf) -> str | None:
        """Return the first user who has waited too long without a worker, if a task that took `worked` may give way."""
        heads = {user: line.next() for user, line in self._lines.items() if not self._running[user]}
        held = [
            user
            for user, head in heads.items()
            if now - head.since >= STANDBY_WAIT_S and worked >= math.ldexp(TRIAL_S, head.set_back)
        ]
        return min(held, key=lambda user: (heads[user].set_back, *self._order(user)), default=None)

    def _used_by(self, user: str, now: float) -> float:
        spent, at = self._used.get(user, (0.0, now))
        return spent * math.exp2((at - now) / HALF_LIFE_S)

    def _forget_unused(self, now: float) -> dict[str, tuple[float, float]]:
        return {name: used for name, used in self._used.items() if self._used_by(name, now) > NEGLIGIBLE_USE_S}

    def _all(self) -> Iterator[Task]:
        return (task for line in self._lines.values() for row in line.rows.values() for task in row)

    def _remove(self, task: Task) -> None:
        line = self._lines[task.asker.user]
        line.remove(task)
        self._count -= 1
        self._size -= task.size
        if not line.count:
            del self._lines[task.asker.user]
