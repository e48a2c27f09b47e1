"""Worker processes behind a bounded queue: a crash costs one job, never the service.

Theory of operation. The caller of `submit` hands its job to an idle worker itself; without one the task waits in the
queue. One thread at a time, the outbox's polling thread, attends to the workers: it waits for their sockets and for the
clock, gives a worker that is done its next job, and settles the task with the worker's answer, or with an error. If a
worker dies, with or without a job, a new process is started; a job that it was handed but never began goes to another
one. A worker writes the number of the job that it began into memory that it shares with the pool, where it reads the
number of the job to end early. Every `CHECK_INTERVAL_S` the thread checks that workers live and keep to their memory
and time. Workers share no lock, so that one that is killed at any instruction can't block another. With several users
one more worker can stand by, for users whom the others' requests delay (`waiting.py`).

While brief jobs wait, a worker that works on a brief one holds the next, and begins it by itself. If it doesn't do
so within `CHECK_INTERVAL_S`, another worker gets it, too, and the first answer counts.
"""

from __future__ import annotations

import contextlib
import itertools
import logging
import math
import selectors
import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial

from guidefield.errors import GuidefieldError, ServerBusy, WorkerCrashed
from guidefield.pool.outbox import Outbox
from guidefield.pool.process import FAILED, PROGRESS, READY, REPLY, SET_BACK, UNPREPARED, Setup
from guidefield.pool.slot import Current, Frame, Worker, spawn
from guidefield.pool.waiting import Answer, Limits, Task, Waiting

CHECK_INTERVAL_S = 0.05  # period at which workers that work and tasks that wait are checked [s]
ACTIVE_S = 1.0  # time after a task for which the pool still wakes that often, so that no caller has to wake it [s]
RESTART_PAUSE_S = 1.0  # time after a worker that could not be prepared until the next one is started [s]
MAX_STARTS = 3  # number of starts that may fail while a job waits, and of workers that may die before they begin it
REAPING_S = 1.0  # longest wait for a killed process to end [s]
ENDING_PROCESSOR_S = 2.0  # processor time for a job to end early when the pool is closed [s]
ENDING_S = 10.0  # time for that on a busy machine [s]
REQUIRED_WORK_S = 10.0  # time for required work after answers when the pool is closed [s]
STOPPING_S = 10.0
"""Time for killed workers to end, and for their tasks to be settled [s].

`ENDING_S`, `REQUIRED_WORK_S` and this are together at most `END_TIME_S` of `cli/serving.py`: then the service is ended
by force.
"""
CLOSING_CHECK_S = 0.01  # period at which the end of these is checked [s]
DEFAULT_LIMITS = Limits()
DEFAULT_MEMORY = 4 << 30  # memory of a worker [bytes]; in docs/service.md, and in docs/wire.md by `tools/wire_page`

_log = logging.getLogger(__name__)

_Given = list[tuple[Worker, Current]]


@dataclass(eq=False)
class Slot:
    """A place for one worker at a time."""

    worker: Worker | None = None
    is_starting: bool = False
    failed: int = 0  # number of workers in succession that could not be prepared
    start_at: float | None = None  # when to start one, by `time.monotonic()` [s]; None: only if asked to

    @property
    def idle_worker(self) -> Worker | None:
        """Its worker, if that could be given a job."""
        return self.worker if self.worker is not None and self.worker.is_idle else None

    @property
    def is_empty(self) -> bool:
        """Return whether there is no worker, and none comes."""
        return self.worker is None and not self.is_starting


class Pool:
    """Worker processes that answer jobs.

    Attributes:
        outbox: Sends answers; its threads attend to the workers.
        crashes: How many workers had to be replaced.
        waiting: The queue, with each user's use of the processors.
        listened: Whether anybody listens to progress, in memory that is shared with the workers.
    """

    def __init__(
        self, setup: Setup, *, workers: int, limits: Limits = DEFAULT_LIMITS, memory: int = DEFAULT_MEMORY
    ) -> None:
        self._setup, self._memory = setup, memory
        self.waiting = Waiting(limits)
        self._slots = [Slot() for _ in range(workers)]
        self._standing_by = Slot()
        self.listened = spawn.Value("B", 0, lock=False)
        self._numbers = itertools.count(1)
        self._lock = threading.Lock()
        self._first_tried, self._reason = threading.Event(), ""
        self._starter = ThreadPoolExecutor(1, "guidefield-starter")  # one thread: workers end with it
        self._selector = selectors.DefaultSelector()
        self._woken, self._waking = socket.socketpair()
        self._woken.setblocking(False)
        self._selector.register(self._woken, selectors.EVENT_READ, self._be_woken)
        self._calls: deque[Callable[[], None]] = deque()
        self._sleeps_until = self._look_at = self._active_until = 0.0
        self.outbox = Outbox(self._attend)
        self.crashes = 0

    @property
    def workers(self) -> int:
        """Number of workers, without the one that stands by."""
        return len(self._slots)

    @property
    def busy(self) -> int:
        """Number of them that have a job."""
        return sum(slot.worker is not None and slot.worker.current is not None for slot in self._slots)

    @property
    def memory(self) -> int:
        """Resident memory of all workers [bytes]."""
        return sum(worker.memory for worker in self._all_workers())

    def start(self) -> None:
        """Start the first worker; the others follow it, so that they find its caches."""
        self.outbox.begin_polling()
        self._start(self._slots[0])

    def ready(self, timeout: float) -> bool:
        """Return whether the first worker is ready within a time [s].

        Raises RuntimeError if it cannot be prepared; its log says why.
        """
        if not self._first_tried.wait(timeout):
            return False
        if self._reason:
            raise RuntimeError(f"a worker process could not be prepared{self._reason}")
        for slot in self._slots[1:]:
            self._start(slot)
        return True

    def stand_by(self) -> None:
        """Have one more worker for users whom others hold up; once is enough, and a pool that is closed has none."""
        if self._standing_by.is_empty and self._standing_by.start_at is None:
            self._start(self._standing_by)

    def submit(self, task: Task) -> Task:
        """Have a task done; its job must pickle.

        It comes to the answer; or to WorkerCrashed, or to ServerBusy where the pool is closed before the job's turn.
        Raises ServerBusy if too much waits already, or the pool is closed.
        """
        with self._lock:
            pushed_out = self.waiting.add(task)
            given = self._assign()
            due = min((one.at for one in (task.deadline, task.late) if one is not None), default=math.inf)
            is_asleep = self._sleeps_until > min(due, time.monotonic() + 2.0 * CHECK_INTERVAL_S)
        for pushed in pushed_out:
            reason = "the queue is full, and of you the most waits; ask again later"
            pushed.set_exception(ServerBusy(reason, retry_after=self.waiting.retry_after(pushed.asker.user)))
        self._give(given)
        if is_asleep:
            self._wake()
        return task

    def cancel(self, task: Task, answer: Callable[[], Answer]) -> None:
        """End a task early: answer it so if it still waits; if it is worked on, tell the worker to come to an end."""
        task.if_cancelled = answer
        task.cancelled_by_client = True
        if self.waiting.withdraw(task):
            task.set_result(answer())
            return
        for worker in self._all_workers():
            worker.pass_on_cancel()

    def close(self, grace: float) -> None:
        """Refuse what waits, let workers finish for a while [s], have them come to an end, then kill them.

        They do required work after their answers before that. Without any grace no job is waited for. Every future is
        settled on return, at the latest `ENDING_S`, `REQUIRED_WORK_S` and `STOPPING_S` after the grace; unless a task's
        callback doesn't return: then the log says that its worker is left behind.
        """
        for task in self.waiting.close():
            task.set_exception(ServerBusy("the service is shutting down"))
        _await(lambda: not any(worker.current for worker in self._all_workers()), grace)
        for worker in self._all_workers():
            if worker.current is not None:
                worker.current.task.cancelled_by_client = True
                worker.pass_on_cancel()
        if grace > 0.0:
            may_use = {one: one.processor + ENDING_PROCESSOR_S for one in self._all_workers() if one.current}
            _await(lambda: not any(one.current and one.processor < most for one, most in may_use.items()), ENDING_S)
        _await(lambda: not any(worker.has_required_work for worker in self._all_workers()), REQUIRED_WORK_S)

        def have_ended() -> bool:
            for worker in self._all_workers():
                worker.kill()
            return all(slot.is_empty for slot in self._all_slots())

        if _await(have_ended, STOPPING_S):
            self.outbox.end_polling(self._wake)
        else:
            _log.error("a worker can't be stopped or its task settled in %g s; it is left behind", STOPPING_S)
        self._starter.shutdown(wait=False)

    def _all_slots(self) -> tuple[Slot, ...]:
        return (*self._slots, self._standing_by)

    def _all_workers(self) -> list[Worker]:
        return [slot.worker for slot in self._all_slots() if slot.worker is not None]

    def _start(self, slot: Slot) -> None:
        with self._lock:
            if self.waiting.closed or not slot.is_empty:
                return
            slot.is_starting, slot.start_at = True, None
        self._starter.submit(self._start_worker, slot)

    def _start_worker(self, slot: Slot) -> None:
        worker = Worker(self._setup, self._memory, self.listened)
        try:
            worker.start()
        except Exception as error:  # out of processes or of memory: the next attempt may do
            _log.exception("a worker process could not be started")
            worker.reason = str(error)
        self._call(partial(self._welcome, slot, worker))

    def _welcome(self, slot: Slot, worker: Worker) -> None:
        with self._lock:
            slot.worker, slot.is_starting = worker, False
        if worker.process.pid is None:
            self._bury(slot, worker)
            return
        self._selector.register(worker.socket, selectors.EVENT_READ, partial(self._hear, slot, worker))
        self._selector.register(worker.process.sentinel, selectors.EVENT_READ, partial(self._hear_last, slot, worker))

    def _call(self, what: Callable[[], None]) -> None:
        self._calls.append(what)
        self._wake()

    def _wake(self) -> None:
        with contextlib.suppress(BlockingIOError):
            self._waking.send(b".")

    def _be_woken(self) -> None:
        with contextlib.suppress(BlockingIOError):
            self._woken.recv(1 << 10)
        while self._calls:
            _do(self._calls.popleft())

    def _attend(self) -> None:
        """Wait for the workers or the clock, and do what is due; called by one thread at a time."""
        for key, _ in self._selector.select(self._pause()):
            _do(key.data)
        if (now := time.monotonic()) >= self._look_at:
            _do(partial(self._look_after, now))

    def _pause(self) -> float | None:
        with self._lock:
            now, slots = time.monotonic(), self._all_slots()
            is_active, due_at = now < self._active_until or len(self.waiting) > 0, self.waiting.due_at
            for slot in slots:
                if slot.start_at is not None:
                    due_at = min(due_at, slot.start_at)
                if slot.worker is not None:
                    is_active, due_at = is_active or slot.worker.is_working, min(due_at, slot.worker.late_at)
            self._look_at = min(due_at, now + CHECK_INTERVAL_S)
            self._sleeps_until = self._look_at if is_active else due_at
            return None if self._sleeps_until == math.inf else max(0.0, self._sleeps_until - now)

    def _hear(self, slot: Slot, worker: Worker) -> None:
        awaits_room = worker.has_rest and not worker.send_rest()
        if awaits_room != worker.awaits_room:
            worker.awaits_room = awaits_room
            events = selectors.EVENT_READ | (selectors.EVENT_WRITE if awaits_room else 0)
            self._selector.modify(worker.socket, events, partial(self._hear, slot, worker))
        try:
            for frame in worker.read():
                self._take(slot, worker, frame)
        except EOFError:
            worker.kill()
            self._bury(slot, worker)

    def _hear_last(self, slot: Slot, worker: Worker) -> None:
        """Take the last frames of a worker that has ended, which may have its answer."""
        if slot.worker is worker:
            self._hear(slot, worker)
            self._bury(slot, worker)

    def _take(self, slot: Slot, worker: Worker, frame: Frame) -> None:
        if frame.kind == READY:
            with self._lock:
                worker.is_ready, slot.failed = True, 0
                given = self._assign()
            self._first_tried.set()
            self._give(given)
        elif frame.kind == UNPREPARED:
            worker.reason = frame.what.decode()
        elif frame.kind == PROGRESS:
            if worker.current is not None and worker.current.number == frame.number:
                worker.current.task.hear(frame.what)
        else:
            self._end(worker, frame)

    def _end(self, worker: Worker, frame: Frame) -> None:
        """Settle the task that a worker is done with, after giving it the next one."""
        with self._lock:
            now = time.monotonic()
            current = worker.done_with(frame.number, now)
            if current is None:
                return
            self._active_until = now + ACTIVE_S
            self.waiting.settle(current.task, now - current.since, frame.processor)
            waits = frame.kind == SET_BACK and not current.task.done() and self._wait_again(current.task, gave_way=True)
            given = self._assign()
        self._give(given)
        task = current.task
        if task.done():  # it was answered while the worker still worked on it
            task.end_late()
        if waits or task.done():
            return
        if frame.kind == FAILED:
            task.set_exception(WorkerCrashed(f"the work failed: {frame.what.decode()}"))
        elif frame.kind != SET_BACK:
            task.set_result((frame.kind == REPLY, frame.what))
        else:
            _end_early(task)

    def _assign(self) -> _Given:
        """Choose tasks for idle workers; called under the lock. `_give` hands them over, without it."""
        given: _Given = []
        for slot in self._slots if len(self.waiting) else ():
            worker = slot.idle_worker
            if worker is None:
                continue
            task = self.waiting.take()
            if task is None:
                break
            given.append((worker, self._occupy(worker, task)))
        if not len(self.waiting):
            return given
        now = time.monotonic()
        for slot in self._slots:
            holder = slot.worker
            if holder is not None and holder.could_hold(now - CHECK_INTERVAL_S):
                task = self.waiting.take(brief=True)
                if task is None:
                    break
                holder.held = Current(task, next(self._numbers), now)
                given.append((holder, holder.held))
        return given

    def _occupy(self, worker: Worker, task: Task) -> Current:
        worker.current = Current(task, next(self._numbers), time.monotonic())
        worker.pass_on_cancel()
        return worker.current

    def _give(self, given: _Given) -> None:
        for worker, current in given:
            try:
                current.task.begin()
                if not worker.give(current):
                    self._call(partial(self._send_rest, worker))
            except Exception as error:  # it doesn't pickle, or its listener failed
                _log.exception("a job could not be handed over")
                self._call(partial(self._end, worker, Frame(FAILED, current.number, 0.0, str(error).encode())))

    def _send_rest(self, worker: Worker) -> None:
        for slot in self._all_slots():
            if slot.worker is worker:
                self._hear(slot, worker)

    def _bury(self, slot: Slot, worker: Worker) -> None:
        """Settle the task of a worker that has ended, or put it back if it was never begun; start the next worker."""
        if slot.worker is not worker:
            return
        for end in (worker.socket, worker.process.sentinel) if worker.process.pid is not None else ():
            self._selector.unregister(end)
        code = worker.end(REAPING_S)
        with self._lock:
            slot.worker, current, worker.current = None, worker.current, None
            now = time.monotonic()
            self._take_back(worker)
            is_begun = current is not None and worker.line.numbers.begun == current.number
            waits = False
            if current is not None:
                self.waiting.settle(current.task, now - current.since, now - current.since if is_begun else 0.0)
                current.task.handed += 1
                if not is_begun and worker.reason is None and current.task.handed < MAX_STARTS:
                    waits = current.task.done() or self._wait_again(current.task, gave_way=False)
            slot.failed += not worker.is_ready
            slot.start_at = now + RESTART_PAUSE_S * (not worker.is_ready)
            given = self._assign()
        self._give(given)
        if current is not None and current.task.done():
            current.task.end_late()
        elif current is not None and not waits:
            current.task.set_exception(self._fault_of(worker, code, is_begun))
        if self.waiting.closed:
            return
        if worker.is_ready:
            self.crashes += 1
            _log.warning("worker process %s is replaced", worker.process.pid)
        else:
            why = f": {worker.reason}" if worker.reason else "; its log says why"
            _log.error("a worker process could not be prepared%s", why)
            if slot is self._slots[0] and not self._first_tried.is_set():
                self._reason = why
                self._first_tried.set()
            if all(one.failed >= MAX_STARTS or (one.is_empty and one.start_at is None) for one in self._slots):
                while (task := self.waiting.take()) is not None:  # no worker ever can
                    self.waiting.settle(task, 0.0, 0.0)
                    task.set_exception(WorkerCrashed("no worker process could be started; the service keeps trying"))

    def _take_back(self, worker: Worker) -> None:
        """Let the job that a worker holds wait again; called under the lock. Its answer, if any, is ignored."""
        if worker.held is not None:
            task, worker.held = worker.held.task, None
            self.waiting.settle(task, 0.0, 0.0)
            if not self._wait_again(task, gave_way=False) and not task.done():
                self._call(partial(_end_early, task))

    def _wait_again(self, task: Task, *, gave_way: bool) -> bool:
        """Let a task that was taken wait again, unless it was cancelled or the pool is closed; return whether."""
        with contextlib.suppress(ServerBusy):
            return self.waiting.put_back(task, gave_way=gave_way)
        return False

    def _fault_of(self, worker: Worker, code: int | None, is_begun: bool) -> GuidefieldError:
        if isinstance(worker.reason, WorkerCrashed):
            return worker.reason
        if self.waiting.closed:
            if not is_begun:
                return ServerBusy("the service is shutting down")
            return WorkerCrashed("the service is shutting down and could not wait for this request")
        how = "" if not code else f" of signal {-code}" if code < 0 else f" with exit code {code}"
        return WorkerCrashed(f"the process that worked on this request died{how}; the service lives on")

    def _look_after(self, now: float) -> None:
        for task in self.waiting.take_expired(now):
            assert task.deadline is not None, "only tasks with a deadline expire"
            task.end_overdue(task.deadline)
        for slot in self._all_slots():
            if slot.worker is not None and slot.worker.is_working:
                self._look_after_worker(slot, slot.worker, slot.worker.current, now)
            if slot.start_at is not None and now >= slot.start_at:
                slot.start_at = None
                self._start(slot)
        with self._lock:
            for holder in self._all_workers():
                if holder.held is not None and now - holder.held.since > CHECK_INTERVAL_S:
                    self._take_back(holder)
            given = self._assign()
            worker = self._standing_by.idle_worker
            if worker is not None and not any(slot.idle_worker for slot in self._slots):
                held_up = self.waiting.take_held_up(now)
                given += [] if held_up is None else [(worker, self._occupy(worker, held_up))]
        self._give(given)

    def _look_after_worker(self, slot: Slot, worker: Worker, current: Current | None, now: float) -> None:
        task = None if current is None else current.task
        if task is not None and task.late is not None and now >= worker.late_at:
            task.end_overdue(task.late)
        if current is not None and slot is self._standing_by and self.waiting.is_held_up(now - current.since):
            worker.set_back()
        if worker.memory > self._memory:
            reason, limit = "the request took more than {} MiB of memory and was stopped", self._memory // 2**20
            worker.reason = WorkerCrashed(reason.format(limit), mebibytes=limit)
        elif current is not None and task is not None and now - current.since > task.seconds:
            reason = f"the request took longer than {task.seconds:g} s and was stopped"
            worker.reason = WorkerCrashed(reason, seconds=task.seconds)
        if worker.reason is not None:
            worker.kill()
        if not worker.process.is_alive():
            self._hear_last(slot, worker)


def _do(what: Callable[[], None]) -> None:
    """Do one of several steps: the polling thread must outlive a bug in it, and do the others."""
    try:
        what()
    except Exception:
        _log.exception("the pool failed")


def _end_early(task: Task) -> None:
    if task.if_cancelled is not None:
        task.set_result(task.if_cancelled())
    else:
        task.set_exception(ServerBusy("the service is shutting down"))


def _await(is_done: Callable[[], bool], within: float) -> bool:
    until = time.monotonic() + within
    while not is_done():
        if time.monotonic() >= until:
            return False
        time.sleep(CLOSING_CHECK_S)
    return True
