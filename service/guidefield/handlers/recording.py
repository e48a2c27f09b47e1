"""What a handler asks of whoever records its run."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, TypeVar

from guidefield.messages.replies import MotionReply
from guidefield.planner.quality import ClearanceProfile
from guidefield.planner.task.trace import Event

_R_contra = TypeVar("_R_contra", bound=MotionReply, contravariant=True)


class Recording(Protocol[_R_contra]):
    """Somebody who records a run: an observer who is told the end, once."""

    def observe(self, event: Event) -> None:
        """Be told of an event."""

    def finish(self, reply: _R_contra, profile: Callable[[], ClearanceProfile | None]) -> None:
        """Be told the end, and write; the clearance along the way is measured when it is asked for."""


class RecordingInPieces(Protocol[_R_contra]):
    """The same of whoever writes piece by piece."""

    def observe(self, event: Event) -> None:
        """Be told of an event."""

    def finish(
        self, reply: _R_contra, profile: Callable[[], ClearanceProfile | None], pause: Callable[[], None]
    ) -> None:
        """Be told the end, and write; `pause` is called between pieces of the work."""
