"""The interface of observers of a stream: they get its updates and answers in order, enough to replay it."""

from __future__ import annotations

from collections.abc import Callable

from guidefield.errors import GuidefieldError
from guidefield.messages.streams import Piece, StreamGoal, StreamState, StreamUpdate
from guidefield.stream.state import Snapshot


class Watching:
    """Hears of a stream, and does nothing about it; none of these may take long, or raise."""

    def begun(self) -> None:
        """An update came, and is worked on."""

    def updated(
        self,
        update: StreamUpdate,
        answer: Piece | StreamState | None,
        refused: GuidefieldError | None,
        *,
        noted: bool,
        took: bool,
    ) -> None:
        """An update was worked on.

        Args:
            answer: What was answered; None where it was noted, or refused.
        """

    def sought(self, goal: StreamGoal) -> None:
        """Configurations of a goal are looked for."""

    def aimed(self, number: int | None) -> None:
        """The goal is another one: what was looked for as the n-th; None: to stand."""

    def halted(self) -> None:
        """A stop was asked for."""

    def may_rest(self, snapshot: Callable[[], Snapshot], *, planning: bool) -> None:
        """What the stream goes on from can be had.

        Args:
            snapshot: That; a way that is being planned is given up then, and planned again.
        """
