"""How much each instance has to do, as far as a client knows: its own questions exactly, others' as told last."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class _Told:
    """What an instance told: how many workers it has, and how much of what it had to do was not this client's."""

    workers: int
    others: int


class Loads:
    """How much each instance has to do; any thread may ask and tell."""

    def __init__(self) -> None:
        self._own = Counter[str]()
        self._told: dict[str, _Told] = {}
        self._lock = threading.Lock()

    def begin(self, instance: str) -> None:
        """A question of this client's goes to an instance."""
        with self._lock:
            self._own[instance] += 1

    def end(self, instance: str) -> None:
        """It is answered, or won't be."""
        with self._lock:
            self._own[instance] -= 1

    def be_told(self, instance: str, workers: int, work: int) -> None:
        """What an instance tells of itself: how many workers it has, and what they work on or waits for them."""
        with self._lock:
            self._told[instance] = _Told(max(workers, 1), max(0, work - self._own[instance]))

    def forget(self, instance: str) -> None:
        """It is gone; when it comes back it has nothing to do, as far as is known."""
        with self._lock:
            self._told.pop(instance, None)

    def least(self, instances: Iterable[str], preferred: str | None) -> str | None:
        """The instance that has the least to do for each worker; of those that are equal the preferred one.

        Args:
            instances: Those that come into question.
            preferred: One of them, maybe.
        """
        with self._lock:
            shares = {name: self._share(name) for name in sorted(instances)}
        return min(shares, key=lambda name: (shares[name], name != preferred), default=None)

    def _share(self, instance: str) -> float:
        told = self._told.get(instance, _Told(1, 0))
        return (self._own[instance] + told.others) / told.workers
