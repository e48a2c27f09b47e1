"""One worker process at a time, and the thread that looks after it."""

from __future__ import annotations

import contextlib
import itertools
import logging
import multiprocessing
import os
import socket
import sys
import threading
import time
from concurrent.futures import CancelledError, wait
from concurrent.futures.process import BrokenProcessPool
from typing import Any

from pebble import ProcessExpired, ProcessPool

from guidefield.errors import GuidefieldError, ServerBusy, WorkerCrashed
from guidefield.pool.process import Line, Setup, prepare, work
from guidefield.pool.waiting import Answer, Task, Waiting
from guidefield.pool.watch import Watch

IDLE_CHECK = 0.5
"""How often an idle slot looks whether its worker lives [s]."""
BUSY_CHECK = 0.05
"""How often a worker that works is looked after, and what it tells is passed on [s]."""
SHORTEST_PAUSE = 0.001
"""How soon a worker may be looked after again [s]."""
RESTART_PAUSE = 1.0
"""How long a slot waits before it tries again to start a worker that could not start [s]."""
STARTS_TRIED = 3
"""How often a worker may fail to start while a job waits for it."""
OWED_WITHIN = 10.0
"""How long a worker that is no longer needed may take for what it owes [s]."""
LONGEST_TELLING = 1 << 16
"""Longest thing that a worker can tell at once [bytes]."""
SENDING_ROOM = 4 * LONGEST_TELLING
"""So much of what a worker tells may wait to be heard [bytes]; macOS sends no packet longer than that."""
PACKETS = socket.SOCK_SEQPACKET if sys.platform == "linux" else socket.SOCK_DGRAM
"""How whole packets go from a worker to its slot: macOS has only datagrams, and Linux lets few of those wait."""

_log = logging.getLogger(__name__)
_spawn = multiprocessing.get_context("spawn")


class Slot:
    """One worker process at a time, and the thread that looks after it.

    Args:
        setup: Prepares each worker.
        waiting: The queue that it takes its jobs from.
        memory: A worker that takes more is stopped [bytes].
        stands_by: Whether it works for nobody but users who have no other worker, when they wait for too long.
    """

    def __init__(self, setup: Setup, waiting: Waiting, memory: int, *, stands_by: bool = False) -> None:
        self._setup = setup
        self._waiting = waiting
        self._memory = memory
        self._stands_by = stands_by
        self._take = waiting.take_held_up if stands_by else waiting.take
        self._heard, told = socket.socketpair(socket.AF_UNIX, PACKETS)
        self._heard.setblocking(False)
        told.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SENDING_ROOM)
        begun, cancelled, set_back, prepared, owed = (_spawn.Value("Q", 0, lock=False) for _ in range(5))
        self._line = Line(begun, cancelled, set_back, prepared, owed, told)
        self._numbers = itertools.count(1)
        self._pool: ProcessPool | None = None
        self._watch: Watch | None = None
        self._current: tuple[Task, int] | None = None
        self._tried = threading.Event()
        self._reason = ""
        self._thread = threading.Thread(target=self._run, name="guidefield-slot", daemon=True)
        self.replaced = 0

    @property
    def busy(self) -> bool:
        """Whether its worker works."""
        return self._current is not None

    @property
    def owes(self) -> bool:
        """Whether its worker has something left to do after its answers, and nothing else."""
        watch = self._watch
        return self._line.owed.value > 0 and self._current is None and watch is not None and self.alive

    @property
    def memory(self) -> int:
        """Resident memory of its worker [bytes]; 0 where there is none."""
        watch = self._watch
        return 0 if watch is None else watch.memory()

    @property
    def processor(self) -> float:
        """How long processors worked on its worker [s]; 0 where there is none."""
        watch = self._watch
        return 0.0 if watch is None else watch.processor()

    def start(self) -> None:
        """Start the thread, which starts the worker."""
        self._thread.start()

    def ready(self, timeout: float) -> bool:
        """Whether the worker is ready within a time [s].

        Raises:
            RuntimeError: if the first attempt to start it failed.
        """
        if not self._tried.wait(timeout):
            return False
        if self._watch is None:
            raise RuntimeError(f"a worker process could not be prepared{self._reason or '; its log says why'}")
        return True

    @property
    def alive(self) -> bool:
        """Whether its thread runs."""
        return self._thread.is_alive()

    def join(self, timeout: float) -> None:
        """Wait for the thread to end, which it does once the queue is closed and its job is answered [s]."""
        if self._thread.ident is not None:
            self._thread.join(max(0.0, timeout))

    def kill_worker(self) -> None:
        """End the worker at once; its job is answered as crashed."""
        watch = self._watch
        if watch is not None and self.alive:
            watch.kill()

    def cancel(self) -> None:
        """Tell the worker to bring its job to an end, if it has one."""
        current = self._current
        if current is not None:
            current[0].cancelled_by_client.set()
            self.pass_on_cancel()

    def pass_on_cancel(self) -> None:
        """Let the worker know if its job is to be ended early."""
        current = self._current
        if current is not None and current[0].cancelled_by_client.is_set():
            self._line.cancelled.value = current[1]

    def _run(self) -> None:
        self._start_worker()
        self._tried.set()
        while not self._waiting.closed or len(self._waiting):
            if self._pool is None or self._watch is None or not self._pool.active or not self._watch.alive():
                self._replace_worker()
            task = self._take(IDLE_CHECK)
            if task is not None:
                self._settle(task)
        self._await_owed()
        self._stop_worker()
        self._heard.close()
        self._line.told.close()

    def _await_owed(self) -> None:
        """Let the worker do what it still has to, for a while."""
        until = time.monotonic() + OWED_WITHIN
        while self.owes and self._watch is not None and self._watch.alive() and time.monotonic() < until:
            time.sleep(BUSY_CHECK)

    def _settle(self, task: Task) -> None:
        try:
            answer = self._counted(task)
            if answer is None:
                self._put_back(task)
            elif not task.done():  # else it was answered while the worker still prepared for it
                task.set_result(answer)
        except GuidefieldError as error:
            _refuse(task, error)
        except Exception as error:  # the slot must outlive its own bugs, and the caller must hear of them
            _log.exception("a slot failed")
            _refuse(task, WorkerCrashed(f"the pool failed: {error}"))

    def _put_back(self, task: Task) -> None:
        """Let a task wait again that was set back, unless somebody cancelled it meanwhile, or it was answered."""
        if task.done() or self._waiting.put_back(task):
            return
        if task.if_cancelled is None:
            raise ServerBusy("the service is shutting down")
        task.set_result(task.if_cancelled())

    def _counted(self, task: Task) -> Answer | None:
        """The answer; the queue is told what it took. Of a worker that had to be replaced all of the time counts."""
        began, watch, before = time.monotonic(), self._watch, self.processor
        try:
            return self._answer(task)
        finally:
            seconds = time.monotonic() - began
            spent = self.processor - before if self._watch is watch else seconds
            self._waiting.done(task, seconds, spent)

    def _answer(self, task: Task) -> Answer | None:
        failed = 0
        while failed < STARTS_TRIED:
            if self._pool is None or self._watch is None:
                if self._waiting.closed:
                    break
                failed += 1
                self._replace_worker()
                continue
            number = next(self._numbers)
            self._current = task, number
            self.pass_on_cancel()
            task.begin()
            try:
                return self._attend(task, self._pool.schedule(work, args=(number, task.job)), self._watch)
            except WorkerCrashed:
                self._replace_worker()
                raise
            except (ProcessExpired, BrokenProcessPool, CancelledError, RuntimeError, OSError) as error:
                begun = self._line.begun.value == number
                self._replace_worker()
                if begun and self._waiting.closed:
                    raise WorkerCrashed("the service is shutting down and could not wait for this request") from None
                if begun:
                    raise WorkerCrashed(
                        f"the process that worked on this request died{_how(error)}; the service lives on"
                    ) from None
            finally:
                self._current = None
        raise WorkerCrashed("no worker process could be started; the service keeps trying")

    def _attend(self, task: Task, future: Any, watch: Watch) -> Answer | None:
        """The worker's answer, None if the task was set back.

        What the worker tells meanwhile is passed on, and it is stopped if it takes too much.
        """
        began = time.monotonic()
        stop_at = began + task.seconds
        while not wait([future], self._pause(task)).done:
            self._pass_on(task)
            self._answer_late(task)
            if self._stands_by and self._waiting.is_held_up(time.monotonic() - began):
                self._set_back()
            if watch.memory() > self._memory:
                watch.kill()
                limit = self._memory // 2**20
                raise WorkerCrashed(
                    f"the request took more than {limit} MiB of memory and was stopped", mebibytes=limit
                )
            if time.monotonic() > stop_at:
                watch.kill()
                raise WorkerCrashed(
                    f"the request took longer than {task.seconds:g} s and was stopped", seconds=task.seconds
                )
            if not watch.alive() and not wait([future], 2 * BUSY_CHECK).done:
                raise ProcessExpired("ended in the middle of its work", code=0)
        self._pass_on(task)
        answer: Answer | None = future.result()
        return answer

    def _set_back(self) -> None:
        """Have the worker end its task early, to begin anew when it is its turn again."""
        current = self._current
        if current is not None:
            self._line.set_back.value = current[1]

    def _pause(self, task: Task) -> float:
        """How long to wait before the worker is looked after again [s]."""
        if task.late is None or task.done():
            return BUSY_CHECK
        return min(BUSY_CHECK, max(SHORTEST_PAUSE, task.late.at - time.monotonic()))

    def _answer_late(self, task: Task) -> None:
        """Answer a task in the worker's place if its time is up and the worker still prepares for it."""
        late, current = task.late, self._current
        assert current is not None, "a worker is attended while it works"
        if late is None or task.done() or time.monotonic() < late.at or self._line.prepared.value == current[1]:
            return
        task.set_result(late.answer())

    def _pass_on(self, task: Task) -> None:
        with contextlib.suppress(BlockingIOError):
            while True:
                task.hear(self._heard.recv(LONGEST_TELLING))

    def _start_worker(self) -> None:
        arguments = (self._setup, self._line, self._memory)
        self._reason = ""
        pool = ProcessPool(max_workers=1, initializer=prepare, initargs=arguments, context=_spawn)
        try:
            pid = pool.schedule(os.getpid)
            while not self._waiting.closed and not pid.done() and pool.active:
                wait([pid], IDLE_CHECK)
            if pid.done():
                self._watch, self._pool = Watch(pid.result()), pool
                return
        except (ProcessExpired, BrokenProcessPool, RuntimeError, OSError):
            pass  # as where it ends by itself
        with contextlib.suppress(BlockingIOError):
            self._reason = f": {self._heard.recv(LONGEST_TELLING).decode()}"
        if not self._waiting.closed:
            _log.error("a worker process could not be prepared%s", self._reason)
        _end(pool)

    def _stop_worker(self) -> None:
        if self._watch is not None:
            self._watch.kill()
        if self._pool is not None:
            _end(self._pool)
        self._pool = self._watch = None
        self._line.owed.value = 0

    def _replace_worker(self) -> None:
        if self._pool is None:  # the last attempt to start one failed
            time.sleep(RESTART_PAUSE)
        elif not self._waiting.closed:
            self.replaced += 1
            _log.warning("worker process %s is replaced", None if self._watch is None else self._watch.pid)
        self._stop_worker()
        self._forget_tellings()
        if not self._waiting.closed:
            self._start_worker()

    def _forget_tellings(self) -> None:
        with contextlib.suppress(BlockingIOError):
            while self._heard.recv(LONGEST_TELLING):
                pass


def _refuse(task: Task, error: GuidefieldError) -> None:
    if not task.done():  # else it was answered late, and the worker went on with it
        task.set_exception(error)


def _how(error: Exception) -> str:
    code = getattr(error, "exitcode", None)
    if not code:
        return ""
    return f" of signal {-code}" if code < 0 else f" with exit code {code}"


def _end(pool: ProcessPool) -> None:
    pool.stop()
    pool.join()
