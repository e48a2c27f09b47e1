"""The runs under way, by name: which of them wait or are worked on, and which are to end before they arrive."""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass

from guidefield.pool.pool import Pool
from guidefield.pool.waiting import Answer, Task

REMEMBERED = 10.0
"""How long a cancel that arrives before its run is remembered [s]."""
MOST_REMEMBERED = 1_000


@dataclass(frozen=True)
class _Run:
    task: Task
    cancelled: Callable[[], Answer]
    words: object


class UnderWay:
    """The runs under way.

    Args:
        pool: Where they are worked on.
    """

    def __init__(self, pool: Pool) -> None:
        self._pool = pool
        self._runs: dict[str, _Run] = {}
        self._early: OrderedDict[str, float] = OrderedDict()
        self._lock = threading.Lock()

    def submit(self, run_id: str, task: Task, cancelled: Callable[[], Answer], words: object) -> Task:
        """Have a run made, unless it was cancelled already, or is asked for again in the same words.

        Args:
            run_id: Its name; a second run of a name is left to the store to refuse.
            task: Its task.
            cancelled: What is answered if it is cancelled before it begins.
            words: What it was asked with: whose link broke may ask again, and waits for the same run.

        Returns:
            The task to wait for: this one, or that of the run under way.

        Raises:
            ServerBusy: if too much waits already, or the pool is closed.
        """
        with self._lock:
            self._forget_old()
            if self._early.pop(run_id, None) is not None:
                task.set_result(cancelled())
                return task
            run = self._runs.setdefault(run_id, _Run(task, cancelled, words))
            if run.task is not task and run.words == words:
                return run.task
        task.add_done_callback(lambda _: self._end(run_id, task))
        try:
            return self._pool.submit(task)
        except Exception:
            self._end(run_id, task)
            raise

    def cancel(self, run_id: str) -> str:
        """End a run early; says in a sentence what that means."""
        with self._lock:
            run = self._runs.get(run_id)
            if run is None:
                self._forget_old()
                self._early[run_id] = time.monotonic()
                return f"no run {run_id!r} is under way; if it arrives within {REMEMBERED:g} s, it ends at once"
        self._pool.cancel(run.task, run.cancelled)
        return f"run {run_id!r} ends"

    def _end(self, run_id: str, task: Task) -> None:
        with self._lock:
            run = self._runs.get(run_id)
            if run is not None and run.task is task:
                del self._runs[run_id]

    def _forget_old(self) -> None:
        now = time.monotonic()
        while self._early and (
            len(self._early) >= MOST_REMEMBERED or now - next(iter(self._early.values())) > REMEMBERED
        ):
            self._early.popitem(last=False)
