"""Run work in several threads: kernels, and most of NumPy, run in parallel.

Works must not depend on one another: then the number of threads changes time alone.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor


def run_parallel(*works: Callable[[], object]) -> None:
    """Run several works in parallel: the last one in this thread, the others in threads of their own.

    Raises what one of the works raised, once all have ended.
    """
    with ThreadPoolExecutor(max(1, len(works) - 1), "guidefield-parallel") as threads:
        others = [threads.submit(work) for work in works[:-1]]
        works[-1]()
    for other in others:
        other.result()


def run_queue(works: Iterator[Callable[[], object]], at_once: int) -> None:
    """Run many works in order in several threads, this one among them.

    Args:
        works: Each is taken when it begins; an exception of the iterator ends the queue, as that of a work.
        at_once: Number of threads, at least 1.

    Raises:
        Exception: of one of the works; no more begin then, and running ones are finished.
    """
    taking, ended = threading.Lock(), threading.Event()

    def take() -> Callable[[], object] | None:
        with taking:
            return None if ended.is_set() else next(works, None)

    def share() -> None:
        try:
            while (work := take()) is not None:
                work()
        except BaseException:
            ended.set()
            raise

    run_parallel(*[share] * at_once)


def usable_processors() -> int:
    """Return the number of processors for this process; if the system doesn't say, of all."""
    if hasattr(os, "sched_getaffinity"):  # macOS binds no process to processors
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
