"""A few threads that read and delete files for queries, with the fair queue of `pool/waiting.py`."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

from guidefield.errors import GuidefieldError, ServerBusy, convert_exception
from guidefield.messages.identities import Asker
from guidefield.pool.waiting import Answer, Limits, Task, Waiting

THREADS = 2  # files that are read at once
MOST_READS = 64  # number of queries for files that may wait; in docs/wire.md by `rules.py`: then `tools/wire_page`
TASK_TIME_S = 600.0  # time that a task states; no thread is stopped after it [s]

_log = logging.getLogger(__name__)


class Readers:
    """Threads that answer queries which need files only."""

    def __init__(self) -> None:
        self._waiting = Waiting(Limits(tasks=MOST_READS, tasks_of_client=MOST_READS))
        self._come = threading.Semaphore(0)
        self._threads = [
            threading.Thread(target=self._read_all, name="guidefield-reader", daemon=True) for _ in range(THREADS)
        ]
        for thread in self._threads:
            thread.start()

    def submit(self, asker: Asker, read: Callable[[], Answer]) -> Task:
        """Have `read` called; return the future of its answer or error.

        Raises ServerBusy if too many queries wait already, or the threads end.
        """
        task = Task(read, TASK_TIME_S, asker=asker)
        for pushed in self._waiting.add(task):
            reason = "too many queries wait for the disk, and most of them are yours; ask again later"
            pushed.set_exception(ServerBusy(reason, retry_after=self._waiting.retry_after(pushed.asker.user)))
        self._come.release()
        return task

    def close(self) -> None:
        """Finish running reads, and refuse waiting ones."""
        for task in self._waiting.close():
            task.set_exception(ServerBusy("the service is shutting down"))
        self._come.release(THREADS)
        for thread in self._threads:
            thread.join()

    def _read_all(self) -> None:
        while self._come.acquire() and not self._waiting.closed:
            if (task := self._waiting.take()) is None:  # it was pushed out
                continue
            began = time.monotonic()
            try:
                outcome: Answer | GuidefieldError = task.job()
            except Exception as error:  # the thread must outlive it
                outcome = convert_exception(error)
                if outcome is not error:
                    _log.exception("a query failed by itself")
            seconds = time.monotonic() - began
            self._waiting.settle(task, seconds, seconds)
            if isinstance(outcome, GuidefieldError):
                task.set_exception(outcome)
            else:
                task.set_result(outcome)
