"""The cycle in which a stream takes over a path that is planned beside it: counted, once it is found, or replayed."""

from __future__ import annotations

from collections.abc import Collection
from typing import Protocol

from guidefield.stream.ways import YIELDING, Ordered


class TakeOver(Protocol):
    """Decides in each cycle whether the way that was ordered is taken over."""

    @property
    def niceness(self) -> int:
        """By how much the thread that plans gives way to others."""

    def takes(self, ordered: Ordered, now: float) -> bool:
        """Whether to take it over at an update's time [s]; if it isn't found yet, it is waited for."""


class Counted:
    """A counted time after it was ordered: the same updates get the same pieces, however long planning takes."""

    niceness = 0

    def takes(self, ordered: Ordered, now: float) -> bool:
        """Whether it is due."""
        return now >= ordered.due


class WhenFound:
    """As soon as it is found: nobody ever waits for it.

    Attributes:
        last: Time of the last update at which one was taken over [s]; None: there was none.
    """

    niceness = YIELDING

    def __init__(self) -> None:
        self.last: float | None = None

    def takes(self, ordered: Ordered, now: float) -> bool:
        """Whether it is found."""
        if not ordered.found.done():
            return False
        self.last = now
        return True


class AsBefore:
    """At the updates at which ways were taken over before.

    Args:
        times: Of these updates [s].
    """

    niceness = 0

    def __init__(self, times: Collection[float]) -> None:
        self._times = frozenset(times)

    def takes(self, ordered: Ordered, now: float) -> bool:  # noqa: ARG002 - what was found isn't asked
        """Whether one was taken over then."""
        return now in self._times
