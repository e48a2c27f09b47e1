"""How a service is: starting, ready or ending, and what it does meanwhile."""

from __future__ import annotations

from guidefield.errors import ServerBusy
from guidefield.messages.replies import Health

RETRY_AFTER = 2.0
"""When to ask a service again that is starting [s]."""


class Condition:
    """How a service is; one thread changes it, any may look."""

    def __init__(self) -> None:
        self._now = Health(state="starting", doing="starting")

    @property
    def now(self) -> Health:
        """How it is now."""
        return self._now

    def start(self, doing: str) -> None:
        """It starts, and does this for it."""
        self._now = Health(state="starting", doing=doing)

    def be_ready(self) -> None:
        """It takes requests."""
        self._now = Health(state="ready")

    def end(self, doing: str) -> None:
        """It ends, and does this for it."""
        self._now = Health(state="ending", doing=doing)

    def require_ready(self) -> None:
        """Refuse a request that needs a worker before there is one, or when there won't be any more.

        Raises:
            ServerBusy: unless the service is ready.
        """
        now = self._now
        if now.state == "starting":
            raise ServerBusy(f"the service is starting: {now.doing}; ask again later", retry_after=RETRY_AFTER)
        if now.state == "ending":
            raise ServerBusy("the service is shutting down")
