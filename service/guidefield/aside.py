"""Long work aside, in a thread of its own: who needs it waits no longer than there is time.

Building a mesh or preparing a robot is some long calls into libraries, which nobody can interrupt. Where time is up in
the middle of one, whoever waits goes on without it: the work comes to its end by itself, and what it made is kept for
the next time. Only one work is done at any time, if in parts: what is asked for meanwhile waits until it is done, or
until its own time is up.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from typing import Any, Generic, TypeVar

from guidefield.collector import waiting_collector

LOOK = 0.01
"""How often who waits looks whether there is time left [s]."""

Spent = Callable[[], object]
"""Whether time is up."""

T = TypeVar("T")


class StoppedError(Exception):
    """Time was up before long work was done; the text says before what."""


def done_aside(work: Callable[[], T], spent: Spent, doing: Callable[[], str]) -> T:
    """What long work makes.

    Args:
        work: Does it; what it raises is raised here.
        spent: Whether time is up, asked again and again by the one who waits.
        doing: What is being done at the moment, in a few words.

    Raises:
        StoppedError: if time was up before the work was done, or before it could begin.
    """
    wait_for_others(spent)
    job = _Job(waiting_collector()(work))  # it looks through a hundred thousand obstacles for a tenth of a second
    _jobs[:] = [job]
    job.start()
    while not job.ended.wait(LOOK):
        if spent():
            raise StoppedError(doing())
    _jobs.clear()
    return job.result()


def wait_for_others(spent: Spent) -> None:
    """Wait until what somebody left behind is done.

    Raises:
        StoppedError: if time was up before.
    """
    for job in _jobs:
        while not job.ended.wait(LOOK):
            if spent():
                raise StoppedError("what was asked for before it was done")
    _jobs.clear()


def together(*works: Callable[[], object]) -> None:
    """Do long work in several parts at the same time: the last one here, the others in threads of their own.

    Kernels run beside each other, and most of NumPy. It is over when all parts are.

    Raises:
        Exception: what the first of them raised that did.
    """
    jobs = [_Job(work) for work in works]
    for job in jobs[:-1]:
        job.start()
    jobs[-1].run()
    for job in jobs:
        job.ended.wait()
    for job in jobs:
        job.result()


def spread(works: Iterator[Callable[[], object]], at_once: int) -> None:
    """Do many works, so many at the same time, each begun in its turn: in as many threads, this one among them.

    Args:
        works: They are taken one at a time, as each is to be begun; what taking one raises ends it all, as a work does.
        at_once: At least 1.

    Raises:
        Exception: what one of them raised; no more are begun then, and those that are come to their end.
    """
    taking, ended = threading.Lock(), threading.Event()

    def taken() -> Callable[[], object] | None:
        with taking:
            return None if ended.is_set() else next(works, None)

    def share() -> None:
        try:
            while (work := taken()) is not None:
                work()
        except BaseException:
            ended.set()
            raise

    together(*[share] * at_once)


class _Job(Generic[T]):
    """Work in a thread. The process doesn't end before it: a thread in the middle of a library would take it down."""

    def __init__(self, work: Callable[[], T]) -> None:
        self._work = work
        self._made: list[T] = []
        self._fault: BaseException | None = None
        self.ended = threading.Event()

    def start(self) -> None:
        """Begin."""
        threading.Thread(target=self.run, name="guidefield-aside").start()

    def result(self) -> T:
        """What was made, or raise what was raised."""
        if self._fault is not None:
            raise self._fault
        return self._made[0]

    def run(self) -> None:
        """Do it here."""
        try:
            self._made.append(self._work())
        except BaseException as fault:  # it is raised where it is waited for
            self._fault = fault
        finally:
            self.ended.set()


_jobs: list[_Job[Any]] = []
"""The one that runs, or was left behind."""
