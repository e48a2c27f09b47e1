"""Work in several threads at the same time: kernels run beside each other, and most of NumPy."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor


def run_parallel(*works: Callable[[], object]) -> None:
    """Do all of some works at the same time: the last one here, the others in threads of their own.

    Raises:
        Exception: what one of them raised, once all of them have ended.
    """
    with ThreadPoolExecutor(max(1, len(works) - 1), "guidefield-parallel") as threads:
        others = [threads.submit(work) for work in works[:-1]]
        works[-1]()
    for other in others:
        other.result()


def run_queue(works: Iterator[Callable[[], object]], at_once: int) -> None:
    """Do many works in as many threads as `at_once`, this one among them, each begun in its turn.

    Args:
        works: Each is taken as it is to be begun; what taking one raises ends the queue, as a work does.
        at_once: At least 1.

    Raises:
        Exception: what one of them raised; no more are begun then, and those that are come to their end.
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
