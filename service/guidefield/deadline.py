"""Deadlines: the time by which work must end, and its early cancellation; all long work takes one as an argument.

Times are of `time.monotonic()`, which all processes of a machine share: a request's deadline counts from its arrival.
Deadlines pass over the time in which this process waits for kernels to be compiled or loaded, and replies count it as
loading: whatever makes machine code ready at a first call does so within `waiting_for_kernels`.
"""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

from guidefield.errors import Status


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


def _never() -> bool:
    return False


@dataclass(frozen=True)
class Deadline:
    """The time by which work must end, and the request that ends it early.

    Loops ask `expired` and return the best that they have; a stage without any result calls `check`.
    """

    at: float = math.inf  # on the clock of `time.monotonic` [s]; later by what this process waits for kernels from now
    is_cancelled: Callable[[], bool] = _never  # asks whether the work is to end early
    waited: float = field(default_factory=seconds_waited, compare=False)  # for kernels before `at` was chosen [s]

    def remaining(self) -> float:
        """Return the time that is left [s], at least 0."""
        return max(0.0, self._end() - time.monotonic())

    def _end(self) -> float:
        return self.at + seconds_waited() - self.waited

    def expired(self) -> bool:
        """Return whether the work must end."""
        return self.is_cancelled() or time.monotonic() >= self._end()

    def status(self) -> Status | None:
        """Return PREEMPTED or TIMED_OUT if the work must end, else None."""
        if self.is_cancelled():
            return Status.PREEMPTED
        return Status.TIMED_OUT if time.monotonic() >= self._end() else None

    def check(self, step: str) -> None:
        """Raise DeadlineExpired if the work must end before a step, such as "scene hall was built"."""
        if (status := self.status()) is not None:
            raise DeadlineExpired(status, step)

    def share(self, fraction: float) -> Deadline:
        """Return the deadline of a part that may take a fraction of the remaining time."""
        return Deadline(time.monotonic() + fraction * self.remaining(), self.is_cancelled)

    def at_least(self, seconds: float) -> Deadline:
        """Return the deadline of work that begins now and may always take some time [s], even if cancelled."""
        earliest = time.monotonic() + seconds
        return Deadline(max(self._end(), earliest), lambda: time.monotonic() >= earliest and self.is_cancelled())

    def or_if(self, is_cancelled: Callable[[], bool]) -> Deadline:
        """Return a deadline that another reason ends early, too."""
        return replace(self, is_cancelled=lambda: is_cancelled() or self.is_cancelled())


UNLIMITED = Deadline()  # the deadline of work that may take as long as it does


def end_reason(status: Status) -> str:
    """Say why work ended with PREEMPTED or TIMED_OUT."""
    return "the run was cancelled" if status is Status.PREEMPTED else "time was up"


class DeadlineExpired(Exception):
    """The deadline passed, or the work was cancelled, before a step.

    Args:
        status: TIMED_OUT or PREEMPTED.
        step: The step that was not begun, such as "scene hall was built".
        details: Values to tell about it.
    """

    def __init__(self, status: Status, step: str, **details: Any) -> None:
        super().__init__(step)
        self.status, self.step, self.details = status, step, details
