"""Time in which this process waits for kernels while they are compiled or loaded.

That isn't time of planning: deadlines pass it over, and replies count it as loading. Whatever makes machine code ready
at a first call does so within `waiting_for_kernels`.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Iterator


class _Waited(threading.local):
    """How many waits a thread is within: what a kernel calls may have to be waited for too."""

    depth = 0


_waited, _adding = _Waited(), threading.Lock()
_waits = [0.0]  # their sum [s]


@contextlib.contextmanager
def waiting_for_kernels() -> Iterator[None]:
    """Count the time until it is left."""
    begin = time.monotonic()
    _waited.depth += 1
    try:
        yield
    finally:
        _waited.depth -= 1
        if _waited.depth == 0:
            with _adding:
                _waits[0] += time.monotonic() - begin


def seconds_waited() -> float:
    """Return how long this process has waited for kernels in all [s]."""
    return _waits[0]


def working_time() -> float:
    """Return the time of a clock that stands still while this process waits for kernels [s]; only differences count."""
    return time.perf_counter() - _waits[0]
