"""How long a request may be worked on: until its time is up, or until it is cancelled."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from guidefield.errors import Preempted, TimedOut


@dataclass(frozen=True)
class Allowance:
    """How long a request may be worked on.

    Attributes:
        seconds: What the request allows, from its arrival [s].
        until: When that is up, by `time.monotonic()` [s].
        cancelled: Whether it is to end early.
    """

    seconds: float
    until: float
    cancelled: Callable[[], bool]

    def spent(self) -> bool:
        """Whether to stop."""
        return self.cancelled() or time.monotonic() > self.until

    def require_more(self, done: int, of: int) -> None:
        """Go on if there is time left.

        Args:
            done: How many configurations, poses or points are answered.
            of: How many were asked.

        Raises:
            Preempted: if the request was cancelled.
            TimedOut: if its time is up.
        """
        if self.cancelled():
            raise Preempted(f"the request was cancelled after {done} of {of}", done=done, of=of)
        if time.monotonic() > self.until:
            raise TimedOut(
                f"the {self.seconds:g} s that `allowed_time` allows were up after {done} of {of}; allow more, or "
                "ask for fewer at once",
                allowed_time=self.seconds,
                done=done,
                of=of,
            )


def _never() -> bool:
    return False


UNLIMITED = Allowance(float("inf"), float("inf"), _never)
"""As long as it takes."""
