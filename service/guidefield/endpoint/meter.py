"""What the endpoint counts, and how long its answers take."""

from __future__ import annotations

import threading
from bisect import bisect_left
from collections import Counter

from guidefield.messages.replies import Histogram

BOUNDS = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 60.0)
"""Upper bounds of the histogram's bins [s]."""


class Meter:
    """Counts events and times; any thread may."""

    def __init__(self) -> None:
        self._counters = Counter(asked=0, answered=0, refused=0)
        self._bins: dict[str, list[int]] = {}
        self._sums: dict[str, float] = {}
        self._lock = threading.Lock()

    def count(self, what: str) -> None:
        """Count an event."""
        with self._lock:
            self._counters[what] += 1

    def time(self, kind: str, seconds: float) -> None:
        """Note how long something of a kind took [s]."""
        with self._lock:
            bins = self._bins.setdefault(kind, [0] * (len(BOUNDS) + 1))
            bins[bisect_left(BOUNDS, seconds)] += 1
            self._sums[kind] = self._sums.get(kind, 0.0) + seconds

    def counters(self) -> dict[str, int]:
        """What was counted."""
        with self._lock:
            return dict(self._counters)

    def latency(self) -> dict[str, Histogram]:
        """What was timed, by kind."""
        with self._lock:
            return {
                kind: Histogram(bounds=list(BOUNDS), counts=list(bins), sum=self._sums[kind])
                for kind, bins in self._bins.items()
            }
