"""Time in which this process waits for kernels while they are compiled or loaded.

That isn't time of planning: deadlines pass it over, and replies count it as loading. Whatever makes machine code ready
at a first call does so within `waiting_for_kernels`.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Iterator
from typing import NamedTuple


class _Waits(NamedTuple):
    """Waits that are over, and the one that runs: threads that wait at the same time, or within a wait, count once."""

    total: float = 0.0  # of those that are over [s]
    waiting: int = 0  # how many calls wait now
    since: float = 0.0  # when the first of these began [s]


_waits, _counting = [_Waits()], threading.Lock()


@contextlib.contextmanager
def waiting_for_kernels() -> Iterator[None]:
    """Count the time until it is left."""
    with _counting:
        total, waiting, since = _waits[0]
        _waits[0] = _Waits(total, waiting + 1, since if waiting else time.monotonic())
    try:
        yield
    finally:
        with _counting:
            total, waiting, since = _waits[0]
            _waits[0] = _Waits(total if waiting > 1 else total + time.monotonic() - since, waiting - 1, since)


def _find_waited(now: float) -> float:
    total, waiting, since = _waits[0]
    return total + max(now - since, 0.0) if waiting else total


def seconds_waited() -> float:
    """Return how long this process has waited for kernels in all, until now [s]."""
    return _find_waited(time.monotonic())


def working_time() -> float:
    """Return the time of a clock that stands still while this process waits for kernels [s]; only differences count."""
    now = time.monotonic()
    return now - _find_waited(now)
