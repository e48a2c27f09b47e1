"""Enforce users' quotas of queries, payload, waiting requests and processor time: a query beyond them is refused.

Queries and payload are counted by token buckets; the queue (`pool/waiting.py`) measures waiting and processor time.
"""

from __future__ import annotations

import math
import threading
import time

from guidefield.errors import QuotaExceeded
from guidefield.messages.identities import Quotas
from guidefield.pool.waiting import HALF_LIFE_S, Waiting

MAX_USERS = 1_000  # number of users above which full buckets are forgotten
MINUTE_S = 60.0
STEADY_USE_S = HALF_LIFE_S / math.log(2.0)
"""Use of the processors, as the queue measures it, of a user who has had one processor all the time [s]."""
BURST_BYTES = 256 * 2**20  # payload that a user may send at once; `Quota` of `messages/identities.py` tells it
LIST_COUNTS = 10.0
"""Number of queries as which a list, or all of `info`, counts: it takes that much longer to answer.

`Quota` of `messages/identities.py` tells it in words, the wire page by `rules.py`: after a change, `tools/wire_page`.
"""
MIN_RETRY_S = 0.001  # shortest time after which a user may ask again [s]


class Allowances:
    """Counts users' queries and payload, and refuses what exceeds a quota."""

    def __init__(self, quotas: Quotas, waiting: Waiting) -> None:
        self._quotas, self._waiting = quotas, waiting
        self._queries, self._payloads = _TokenBuckets(), _TokenBuckets()
        self._lock = threading.Lock()

    def ask(self, user: str, size: int = 0, *, lists: bool = False) -> None:
        """Count a query of a user, with a payload of a size [bytes]; `lists`: it asks for a list, or for all of `info`.

        A user with a query left may ask for a list; one with any payload left may send a long one, and waits longer for
        the next. Raises QuotaExceeded if the user asks too often, or sent too much.
        """
        quota, now = self._quotas.of(user), time.monotonic()
        rate, flow = quota.per_second, quota.payload_per_second if size else None
        left, room = 1.0, 1.0
        with self._lock:
            if rate is not None:
                most = max(1.0, rate)
                left = self._queries.rest(user, rate, most, now)
            if flow is not None:
                room = self._payloads.rest(user, flow, BURST_BYTES, now)
            if left >= 1.0 and room > 0.0:
                if rate is not None:
                    self._queries.keep(user, left - (min(LIST_COUNTS, most) if lists else 1.0), rate, most, now)
                if flow is not None:
                    self._payloads.keep(user, room - size, flow, BURST_BYTES, now)
        if rate is not None and left < 1.0:
            raise _make_refusal(f"{rate:g} queries a second", (1.0 - left) / rate, per_second=rate)
        if flow is not None and room <= 0.0:
            what = f"{flow / 2**20:g} MiB of payload a second"
            raise _make_refusal(what, (1.0 - room) / flow, payload_per_second=flow)

    def work(self, user: str) -> None:
        """Raise QuotaExceeded if too many requests of a user wait for workers, or it used their processors too much."""
        quota = self._quotas.of(user)
        if quota.waiting is not None and self._waiting.of_user(user) >= quota.waiting:
            again = self._waiting.retry_after(user)
            raise _make_refusal(f"{quota.waiting} requests that wait", again, waiting=quota.waiting)
        if (most := quota.processor_per_minute) is not None:
            over = self._waiting.used(user) * MINUTE_S / (STEADY_USE_S * most)
            if over > 1.0:
                what = f"{most:g} s of a processor in a minute"
                raise _make_refusal(what, HALF_LIFE_S * math.log2(over), processor_per_minute=most)


class _TokenBuckets:
    """A bucket for each user, refilled at a rate per second up to a most."""

    def __init__(self) -> None:
        self._kept: dict[str, tuple[float, float, float]] = {}  # rest, when that was, when it is full again

    def __len__(self) -> int:
        return len(self._kept)

    def rest(self, user: str, rate: float, most: float, now: float) -> float:
        if user not in self._kept:
            return most
        left, at, _ = self._kept[user]
        return min(most, left + rate * (now - at))

    def keep(self, user: str, left: float, rate: float, most: float, now: float) -> None:
        self._kept[user] = left, now, now + (most - left) / rate
        if len(self._kept) > MAX_USERS:
            self._kept = {name: kept for name, kept in self._kept.items() if kept[2] > now}


def _make_refusal(what: str, again: float, **quota: float) -> QuotaExceeded:
    retry_after = round(max(again, MIN_RETRY_S), 3)
    return QuotaExceeded(f"this user may have {what}; ask again in {retry_after:g} s", **quota, retry_after=retry_after)
