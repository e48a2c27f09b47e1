"""What is left to each user of its quota: a query beyond it is refused at once."""

from __future__ import annotations

import math
import threading
import time

from guidefield.errors import QuotaExceeded
from guidefield.messages.quotas import Quotas
from guidefield.pool.usage import HALVED_IN
from guidefield.pool.waiting import Waiting

MOST_USERS = 1_000
"""For how many users it is remembered when they asked."""
MINUTE = 60.0
STEADY = HALVED_IN / math.log(2.0)
"""What is counted of a user who gets a processor second each second, for long [s]."""
SHORTEST = 0.001
"""The shortest time after which somebody is told to ask again [s]."""


class Allowances:
    """Counts queries, and looks at what waits and what was worked on.

    Args:
        quotas: What users may have.
        waiting: The queue of the workers.
    """

    def __init__(self, quotas: Quotas, waiting: Waiting) -> None:
        self._quotas = quotas
        self._waiting = waiting
        self._left: dict[str, tuple[float, float]] = {}
        self._lock = threading.Lock()

    def ask(self, user: str) -> None:
        """A user asks something.

        Raises:
            QuotaExceeded: if it asks too often.
        """
        rate = self._quotas.of(user).per_second
        if rate is None:
            return
        now, most = time.monotonic(), max(1.0, rate)
        with self._lock:
            left, at = self._left.get(user, (most, now))
            left = min(most, left + rate * (now - at))
            self._left[user] = (left - 1.0 if left >= 1.0 else left), now
            if len(self._left) > MOST_USERS:
                self._forget_idle(now)
        if left < 1.0:
            raise _exceeded(f"{rate:g} queries a second", (1.0 - left) / rate, per_second=rate)

    def work(self, user: str) -> None:
        """A user asks for something that takes a worker.

        Raises:
            QuotaExceeded: if enough of it waits already, or it got enough lately.
        """
        quota = self._quotas.of(user)
        if quota.waiting is not None and self._waiting.of_user(user) >= quota.waiting:
            again = self._waiting.retry_after(user)
            raise _exceeded(f"{quota.waiting} requests that wait", again, waiting=quota.waiting)
        if quota.processor_per_minute is not None:
            most = quota.processor_per_minute
            over = self._waiting.used(user) * MINUTE / (STEADY * most)
            if over > 1.0:
                told = f"{most:g} s of a processor in a minute"
                raise _exceeded(told, HALVED_IN * math.log2(over), processor_per_minute=most)

    def _forget_idle(self, now: float) -> None:
        """Forget those who may ask as often at once as anybody."""
        for user, (left, at) in list(self._left.items()):
            rate = self._quotas.of(user).per_second
            if rate is None or left + rate * (now - at) >= max(1.0, rate):
                del self._left[user]


def _exceeded(what: str, again: float, **quota: float) -> QuotaExceeded:
    retry_after = round(max(again, SHORTEST), 3)
    told = f"this user may have {what}; ask again in {retry_after:g} s"
    return QuotaExceeded(told, **quota, retry_after=retry_after)
