"""One worker process at a time, and the thread that looks after it."""

from __future__ import annotations

import contextlib
import itertools
import logging
import multiprocessing
import os
import signal
import threading
import time
from concurrent.futures import CancelledError, wait
from concurrent.futures.process import BrokenProcessPool

from pebble import ProcessExpired, ProcessPool

from guidefield.errors import GuidefieldError, WorkerCrashed
from guidefield.pool.process import Setup, prepare, work
from guidefield.pool.waiting import Answer, Task, Waiting

IDLE_CHECK = 0.5
"""How often an idle slot looks whether its worker lives [s]."""
RESTART_PAUSE = 1.0
"""How long a slot waits before it tries again to start a worker that could not start [s]."""
STOP_MARGIN = 5.0
"""How much longer than a job's limit the slot waits for the pool's own way to stop it [s]."""

_log = logging.getLogger(__name__)
_spawn = multiprocessing.get_context("spawn")


class Slot:
    """One worker process at a time, and the thread that looks after it.

    Args:
        setup: Prepares each worker.
        waiting: The queue that it takes its jobs from.
    """

    def __init__(self, setup: Setup, waiting: Waiting) -> None:
        self._setup = setup
        self._waiting = waiting
        self._begun = _spawn.Value("Q", 0, lock=False)
        self._numbers = itertools.count(1)
        self._pool: ProcessPool | None = None
        self._pid: int | None = None
        self._tried = threading.Event()
        self._thread = threading.Thread(target=self._run, name="guidefield-slot", daemon=True)
        self.replaced = 0

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
        if self._pid is None:
            raise RuntimeError("a worker process could not be prepared; its log says why")
        return True

    def join(self, timeout: float) -> None:
        """Wait for the thread to end, which it does once the queue is closed and its job is answered [s]."""
        if self._thread.ident is not None:
            self._thread.join(None if timeout == float("inf") else max(0.0, timeout))

    def kill_worker(self) -> None:
        """End the worker at once; its job is answered as crashed."""
        pid = self._pid
        if pid is not None and self._thread.is_alive():
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)

    def _run(self) -> None:
        self._start_worker()
        self._tried.set()
        while not self._waiting.closed or len(self._waiting):
            if self._pool is None or not self._pool.active:
                self._replace_worker()
            task = self._waiting.take(IDLE_CHECK)
            if task is not None:
                self._settle(task)
        self._stop_worker()

    def _settle(self, task: Task) -> None:
        try:
            task.future.set_result(self._answer(task))
        except GuidefieldError as error:
            task.future.set_exception(error)
        except Exception as error:  # the slot must outlive its own bugs, and the caller must hear of them
            _log.exception("a slot failed")
            task.future.set_exception(WorkerCrashed(f"the pool failed: {error}"))

    def _answer(self, task: Task) -> Answer:
        while self._pool is not None:
            number = next(self._numbers)
            try:
                future = self._pool.schedule(work, args=(number, task.job), timeout=task.seconds)
                answer: Answer = future.result(task.seconds + STOP_MARGIN)
            except TimeoutError:
                self._replace_worker()
                raise WorkerCrashed(
                    f"the request took longer than {task.seconds:g} s and was stopped", seconds=task.seconds
                ) from None
            except (ProcessExpired, BrokenProcessPool, CancelledError, RuntimeError, OSError):
                begun = self._begun.value == number
                self._replace_worker()
                if begun:
                    raise WorkerCrashed("the process that worked on this request died; the service lives on") from None
            else:
                return answer
        raise WorkerCrashed("no worker process could be started; the service keeps trying")

    def _start_worker(self) -> None:
        pool = ProcessPool(max_workers=1, initializer=prepare, initargs=(self._setup, self._begun), context=_spawn)
        try:
            pid = pool.schedule(os.getpid)
            while not self._waiting.closed and not pid.done():
                wait([pid], IDLE_CHECK)
            if pid.done():
                self._pid, self._pool = pid.result(), pool
                return
        except (ProcessExpired, BrokenProcessPool, RuntimeError, OSError):
            _log.error("a worker process could not be prepared")
        _end(pool)

    def _stop_worker(self) -> None:
        if self._pool is not None:
            _end(self._pool)
        self._pool = self._pid = None

    def _replace_worker(self) -> None:
        if self._pool is None:  # the last attempt to start one failed
            time.sleep(RESTART_PAUSE)
        else:
            self.replaced += 1
            _log.warning("worker process %s is replaced", self._pid)
        self._stop_worker()
        if not self._waiting.closed:
            self._start_worker()


def _end(pool: ProcessPool) -> None:
    pool.stop()
    pool.join()
