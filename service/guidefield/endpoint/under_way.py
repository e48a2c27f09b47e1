"""What is under way, by name and by client: what waits or is worked on, and what is to end before it arrives."""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass

from guidefield.messages.identities import Asker
from guidefield.pool.pool import Pool
from guidefield.pool.waiting import Answer, Task

REMEMBERED = 10.0
"""How long a cancel that arrives before its run is remembered [s]."""
MOST_REMEMBERED = 1_000

Name = tuple[str, str, str]
"""Whose it is, the key below which it is cancelled, ``runs`` or ``requests``, and its id there."""


@dataclass(frozen=True)
class _Work:
    task: Task
    cancelled: Callable[[], Answer]
    words: object


class UnderWay:
    """What is under way.

    Args:
        pool: Where it is worked on.
    """

    def __init__(self, pool: Pool) -> None:
        self._pool = pool
        self._named: dict[Name, _Work] = {}
        self._all: dict[Task, _Work] = {}
        self._early: OrderedDict[Name, float] = OrderedDict()
        self._lock = threading.Lock()

    def submit(self, name: Name | None, task: Task, cancelled: Callable[[], Answer], words: object) -> Task:
        """Have something done, unless it was cancelled already, or is asked for again in the same words.

        Args:
            name: Its name, if it has one; a second run of a name is left to the store to refuse.
            task: Its task.
            cancelled: What is answered if it is cancelled before it begins.
            words: What it was asked with: whose link broke may ask again, and waits for the same work.

        Returns:
            The task to wait for: this one, or that of the work under way.

        Raises:
            ServerBusy: if too much waits already, or the pool is closed.
        """
        work = _Work(task, cancelled, words)
        with self._lock:
            self._forget_old()
            if name is not None:
                if self._early.pop(name, None) is not None:
                    task.set_result(cancelled())
                    return task
                known = self._named.setdefault(name, work)
                if known is not work and known.words == words:
                    return known.task
            self._all[task] = work
        task.add_done_callback(lambda _: self._end(name, work))
        try:
            return self._pool.submit(task)
        except Exception:
            self._end(name, work)
            raise

    def cancel(self, name: Name) -> str:
        """End something early; says in a sentence what that means."""
        kind, own = name[1].removesuffix("s"), name[2]
        with self._lock:
            work = self._named.get(name)
            if work is None:
                self._forget_old()
                self._early[name] = time.monotonic()
                return f"no {kind} {own!r} is under way; if it arrives within {REMEMBERED:g} s, it ends at once"
        self._pool.cancel(work.task, work.cancelled)
        return f"{kind} {own!r} ends"

    def cancel_all_of(self, asker: Asker) -> int:
        """End early whatever a client asked for; how much that was."""
        with self._lock:
            found = [work for work in self._all.values() if work.task.asker == asker]
        for work in found:
            self._pool.cancel(work.task, work.cancelled)
        return len(found)

    def _end(self, name: Name | None, work: _Work) -> None:
        with self._lock:
            self._all.pop(work.task, None)
            if name is not None and self._named.get(name) is work:
                del self._named[name]

    def _forget_old(self) -> None:
        now = time.monotonic()
        while self._early and (
            len(self._early) >= MOST_REMEMBERED or now - next(iter(self._early.values())) > REMEMBERED
        ):
            self._early.popitem(last=False)
