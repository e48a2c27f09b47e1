"""How much of the processors each user got lately."""

from __future__ import annotations

import math

HALVED_IN = 30.0
"""After which time what a user got counts half [s]: whoever asked for much is served like others after some minutes."""
FORGOTTEN = 1e-3
"""Less than this is nothing [s]."""
NEWEST = 0.1
"""How much the newest request counts for how long one typically takes."""


class Usage:
    """Processor seconds by user, halved every `HALVED_IN`.

    Attributes:
        typical: How long a request takes, as far as was seen [s].
    """

    def __init__(self) -> None:
        self._spent: dict[str, tuple[float, float]] = {}
        self.typical = 1.0

    def of(self, user: str, now: float) -> float:
        """What a user got [s], by a clock's time [s]."""
        spent, at = self._spent.get(user, (0.0, now))
        return spent * math.exp2((at - now) / HALVED_IN)

    def add(self, user: str, seconds: float, processor: float, now: float) -> None:
        """A request of a user took so long, and so much of the processors [s]."""
        self.typical += NEWEST * (seconds - self.typical)
        self._spent[user] = self.of(user, now) + processor, now
        self._spent = {name: spent for name, spent in self._spent.items() if self.of(name, now) > FORGOTTEN}

    def users(self, now: float) -> set[str]:
        """Who got any."""
        return {user for user in self._spent if self.of(user, now) > FORGOTTEN}
