"""A few threads that read and delete files, for one user after the other."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

from guidefield.errors import GuidefieldError, ServerBusy, convert_exception
from guidefield.messages.identities import Asker
from guidefield.pool.waiting import Answer, Limits, Task, Waiting

THREADS = 2
MOST_READS = 64  # how many queries for files may wait
LONGEST = 600.0  # longer than any file takes [s]

_log = logging.getLogger(__name__)


class Readers:
    """Threads that answer what needs files only; the queue is as fair as that of the workers."""

    def __init__(self) -> None:
        self._waiting = Waiting(Limits(tasks=MOST_READS, tasks_of_client=MOST_READS))
        self._come = threading.Semaphore(0)
        self._threads = [
            threading.Thread(target=self._read_all, name="guidefield-reader", daemon=True) for _ in range(THREADS)
        ]
        for thread in self._threads:
            thread.start()

    def submit(self, asker: Asker, read: Callable[[], Answer]) -> Task:
        """Have something read; a future that comes to the answer, or to an error.

        Raises ServerBusy if too much waits already, or the end has come.
        """
        task = Task(read, LONGEST, asker=asker)
        for pushed in self._waiting.add(task):
            told = "too many queries wait for the disk, and most of them are yours; ask again later"
            pushed.set_exception(ServerBusy(told, retry_after=self._waiting.retry_after(pushed.asker.user)))
        self._come.release()
        return task

    def close(self) -> None:
        """Answer what is being read, and refuse what waits to be."""
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
