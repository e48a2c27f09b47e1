"""The current snapshot of robot and scene: any thread reads it, and one after the other replaces it."""

from __future__ import annotations

import threading
from collections.abc import Callable

from guidefield.endpoint.ros.snapshot import Snapshot


class KnownScene:
    """Holds the snapshot of now.

    Args:
        first: The first one.
    """

    def __init__(self, first: Snapshot) -> None:
        self._now = first
        self._changing = threading.Lock()

    @property
    def now(self) -> Snapshot:
        """The snapshot of now."""
        return self._now

    def update(self, change: Callable[[Snapshot], Snapshot]) -> None:
        """Replace it by what it becomes; where that raises, it stays."""
        with self._changing:
            self._now = change(self._now)
