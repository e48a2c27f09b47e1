"""The rest of each user's quota: a query beyond it is refused at once."""

from __future__ import annotations

import math
import threading
import time

from guidefield.errors import QuotaExceeded
from guidefield.messages.quotas import Quotas
from guidefield.pool.waiting import HALVED_IN, Waiting

MOST_USERS = 1_000
"""For how many users it is remembered when they asked."""
MINUTE = 60.0
STEADY = HALVED_IN / math.log(2.0)
"""What is counted of a user who gets a processor second each second, for long [s]."""
AT_ONCE = 256 * 2**20
"""So much payload may come at once [bytes]."""
LIST_COUNTS = 10.0
"""As how many queries one for a list counts, or for all of `info`: so much longer it takes to answer."""
SHORTEST = 0.001
"""The shortest time after which somebody is told to ask again [s]."""


class Allowances:
    """Counts queries, and looks at what waits and what was worked on."""

    def __init__(self, quotas: Quotas, waiting: Waiting) -> None:
        self._quotas = quotas
        self._waiting = waiting
        self._queries, self._payloads = _Refilled(), _Refilled()
        self._lock = threading.Lock()

    def ask(self, user: str, size: int = 0, *, lists: bool = False) -> None:
        """A user asks something.

        Args:
            user: Who.
            size: How long the payload is [bytes]. Whoever has anything left may send a long one, and waits longer for
                the next.
            lists: Whether it asks for a list, or for all of `info`. Whoever has a query left may.

        Raises:
            QuotaExceeded: if it asks too often, or sent too much.
        """
        quota = self._quotas.of(user)
        rate, flow, now = quota.per_second or math.inf, quota.payload_per_second or math.inf, time.monotonic()
        most, most_bytes = max(1.0, rate), float(AT_ONCE)
        with self._lock:
            left = self._queries.left(user, rate, most, now)
            room = self._payloads.left(user, flow, most_bytes, now) if size else most_bytes
            if left >= 1.0 and room > 0.0:
                counts = min(LIST_COUNTS, most) if lists else 1.0
                self._queries.keep(user, left - counts, rate, most, now)
                self._payloads.keep(user, room - size, flow, most_bytes, now)
        if left < 1.0:
            raise _exceeded(f"{rate:g} queries a second", (1.0 - left) / rate, per_second=rate)
        if room <= 0.0:
            told = f"{flow / 2**20:g} MiB of payload a second"
            raise _exceeded(told, (1.0 - room) / flow, payload_per_second=flow)

    def work(self, user: str) -> None:
        """A user asks for something that takes a worker.

        Raises QuotaExceeded if enough of it waits already, or it got enough lately.
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


class _Refilled:
    """What is left to each user of something of which more comes each second, up to a most."""

    def __init__(self) -> None:
        self._kept: dict[str, tuple[float, float, float]] = {}

    def __len__(self) -> int:
        return len(self._kept)

    def left(self, user: str, rate: float, most: float, now: float) -> float:
        """What is left at a time [s], where so much comes each second."""
        if user not in self._kept:
            return most
        left, at, _ = self._kept[user]
        return min(most, left + rate * (now - at))

    def keep(self, user: str, left: float, rate: float, most: float, now: float) -> None:
        """So much is left; it is forgotten once that is the most again, where very many are kept."""
        full = now + (most - left) / rate
        if full > now:
            self._kept[user] = left, now, full
        if len(self._kept) > MOST_USERS:
            self._kept = {name: kept for name, kept in self._kept.items() if kept[2] > now}


def _exceeded(what: str, again: float, **quota: float) -> QuotaExceeded:
    retry_after = round(max(again, SHORTEST), 3)
    told = f"this user may have {what}; ask again in {retry_after:g} s"
    return QuotaExceeded(told, **quota, retry_after=retry_after)
