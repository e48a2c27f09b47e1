"""What a client knows of a stream that a service answers, whether it waits or is of asyncio."""

from __future__ import annotations

from guidefield.client.execution import Motion
from guidefield.client.stream_link import StreamLink
from guidefield.messages.streams import StreamState


class StreamFacts:
    """What is known of a stream, without asking anybody; whoever opens it sets its link."""

    _link: StreamLink

    @property
    def stream_id(self) -> str:
        """Its name."""
        return self._link.stream_id

    @property
    def position_names(self) -> list[str]:
        """Names of the columns of its pieces."""
        return [] if self._link.reply is None else list(self._link.reply.position_names)

    @property
    def now(self) -> float:
        """What the client's clock says [s]."""
        return self._link.clock()

    @property
    def state(self) -> StreamState | None:
        """The last state that came; None: none did."""
        return self._link.state

    @property
    def ended(self) -> StreamState | None:
        """What was said when it ended; None: it goes on, as far as is known."""
        return self._link.ended

    @property
    def late(self) -> int:
        """How many pieces came after they began, and aren't taken."""
        return self._link.execution.late

    def at(self, now: float) -> Motion:
        """Where a robot that takes the pieces is at a time of the client's clock [s]; times must not go back."""
        return self._link.at(now)
