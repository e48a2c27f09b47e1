"""Worker processes behind a bounded queue: a crash costs one job, never the service.

Theory of operation. Each slot is one thread here and one worker process, the only member of a pebble pool of its own:
workers share no lock, so one that is killed at any instruction cannot block another. The slot's thread takes a job from
the common queue, has it done, and settles the job's future: with the worker's answer, or with the error that stands in
for it. After anything but an orderly answer the slot starts a fresh process. A worker that dies while it has nothing to
do is replaced in the same way, and a job that it was handed but never began is handed to its successor; what a worker
has begun, it writes as a number into memory that it shares with its slot; in the same way a slot tells it which job is
to end early. What a worker tells while it works comes back as packets through a socket. Meanwhile its slot looks, every
few hundredths of a second, whether it lives and how much memory it has. A job that waits beyond its deadline is
answered by the one thread that watches the queue. Where there are several users, one more worker can stand by, for
those whom the others' requests hold up.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

from guidefield.errors import ServerBusy
from guidefield.pool.process import Setup
from guidefield.pool.slot import BUSY_CHECK, Slot
from guidefield.pool.waiting import Answer, Limits, Task, Waiting

QUEUE_CHECK = 0.05
"""How often the queue is searched for jobs whose time is up [s]."""
LAST_WORD = 2.0
"""How much of a processor a job that is told to end early may use for it when the pool is closed [s]."""
LAST_WORD_WITHIN = 10.0
"""How long it may take for that, however little of a busy machine it gets [s]."""
STOPPED_WITHIN = 10.0
"""How long slots may take to settle and leave when their workers are killed [s]."""
JOINED_EVERY = 0.2
"""How often a worker is killed until its slot has ended: one may just be starting [s]."""
DEFAULT_LIMITS = Limits()
DEFAULT_MEMORY = 4 << 30
"""Memory that a worker may have [bytes]."""

_log = logging.getLogger(__name__)


class Pool:
    """Worker processes that answer jobs.

    Args:
        setup: Prepares each worker.
        workers: How many.
        limits: How much may wait.
        memory: A worker that takes more is stopped [bytes].
    """

    def __init__(
        self, setup: Setup, *, workers: int, limits: Limits = DEFAULT_LIMITS, memory: int = DEFAULT_MEMORY
    ) -> None:
        self._waiting = Waiting(limits)
        self._slots = [Slot(setup, self._waiting, memory) for _ in range(workers)]
        self._standing_by = Slot(setup, self._waiting, memory, stands_by=True)
        self._standing_by_once = threading.Lock()
        self._watch = threading.Thread(target=self._answer_expired, name="guidefield-queue", daemon=True)

    @property
    def workers(self) -> int:
        """How many workers there are, without the one that stands by."""
        return len(self._slots)

    @property
    def queue(self) -> int:
        """How many jobs wait."""
        return len(self._waiting)

    @property
    def waiting(self) -> Waiting:
        """What waits: how much of whom, and who got how much lately."""
        return self._waiting

    @property
    def busy(self) -> int:
        """How many of them work."""
        return sum(slot.busy for slot in self._slots)

    @property
    def memory(self) -> int:
        """Resident memory of all workers [bytes]."""
        return sum(slot.memory for slot in self._all())

    @property
    def crashes(self) -> int:
        """How many workers had to be replaced."""
        return sum(slot.replaced for slot in self._all())

    def start(self) -> None:
        """Begin to start the workers: the others after the first, so that they find its caches."""
        self._slots[0].start()
        self._watch.start()

    def ready(self, timeout: float) -> bool:
        """Whether the first worker is ready within a time [s].

        Raises:
            RuntimeError: if it cannot be prepared; its log says why.
        """
        first, *others = self._slots
        if not first.ready(timeout):
            return False
        for slot in others:
            slot.start()
        return True

    def stand_by(self) -> None:
        """Have one more worker for users whom others hold up; once is enough, and a pool that is closed has none."""
        if self._standing_by_once.acquire(blocking=False):
            self._standing_by.start()

    def submit(self, task: Task) -> Task:
        """Have a task done; its job must pickle.

        Returns:
            The task, a future that comes to the answer; or to WorkerCrashed, or to ServerBusy where the pool is closed
            before the job's turn.

        Raises:
            ServerBusy: if too much waits already, or the pool is closed.
        """
        for pushed in self._waiting.put(task):
            told = "the queue is full, and of you the most waits; ask again later"
            pushed.set_exception(ServerBusy(told, retry_after=self._waiting.retry_after(pushed.asker.user)))
        return task

    def cancel(self, task: Task, answer: Callable[[], Answer]) -> None:
        """End a task early: answer it so if it still waits; if it is worked on, tell the worker to come to an end."""
        task.if_cancelled = answer
        task.cancelled_by_client.set()
        if self._waiting.withdraw(task):
            task.set_result(answer())
            return
        for slot in self._all():
            slot.pass_on_cancel()

    def close(self, grace: float) -> None:
        """Refuse what waits, let workers finish for a while [s], have them come to an end, then kill them.

        What they owe after their answers they do before. Without any grace nobody is waited for.
        Every future is settled on return, which comes `LAST_WORD_WITHIN`, `OWED_WITHIN` and `STOPPED_WITHIN` after that
        while at the latest; unless who hears of a job doesn't come back from it: then the log says that its slot is
        left behind.
        """
        for task in self._waiting.close():
            task.set_exception(ServerBusy("the service is shutting down"))
        self._standing_by_once.acquire(blocking=False)
        self._join_for(grace)
        for slot in self._all():
            slot.cancel()
        if grace > 0.0:
            self._await_last_words()
        while any(slot.owes for slot in self._all()):  # for `OWED_WITHIN` at most
            self._join_for(JOINED_EVERY)
        deadline = time.monotonic() + STOPPED_WITHIN
        while any(slot.alive for slot in self._all()):
            if time.monotonic() > deadline:
                _log.error("a slot still answers or stops its worker after %g s; it is left behind", STOPPED_WITHIN)
                return
            for slot in self._all():
                slot.kill_worker()
            self._join_for(JOINED_EVERY)

    def _await_last_words(self) -> None:
        """Wait for jobs that are told to end early, by what their workers use of a processor since."""
        deadline = time.monotonic() + LAST_WORD_WITHIN
        may_use = {slot: slot.processor + LAST_WORD for slot in self._all()}

        def is_waited_for(slot: Slot) -> bool:
            return slot.alive and not slot.owes and slot.processor < may_use[slot]

        while time.monotonic() < deadline and (awaited := [slot for slot in self._all() if is_waited_for(slot)]):
            awaited[0].join(BUSY_CHECK)

    def _all(self) -> tuple[Slot, ...]:
        return (*self._slots, self._standing_by)

    def _join_for(self, seconds: float) -> None:
        deadline = time.monotonic() + seconds
        for slot in self._all():
            slot.join(deadline - time.monotonic())

    def _answer_expired(self) -> None:
        while not self._waiting.closed:
            for task in self._waiting.take_expired(time.monotonic()):
                assert task.deadline is not None, "only tasks with a deadline expire"
                task.set_result(task.deadline.answer())
            time.sleep(QUEUE_CHECK)
