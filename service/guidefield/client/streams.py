"""A stream that a service answers, for a client that waits; `asynchronous.py` has its counterpart for asyncio.

Both stand on `stream_link.py`; a new method goes into both classes.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from types import TracebackType
from typing import Any, Self, TypeVar

from guidefield.client import questions
from guidefield.client.exchange import Exchange, await_answer
from guidefield.client.questions import Question
from guidefield.client.stream_link import Answer, Motion, StreamLink
from guidefield.errors import GuidefieldError
from guidefield.messages.stream_requests import StreamAimed, StreamJudged, StreamReply
from guidefield.messages.streams import Piece, StreamGoal, StreamOpen, StreamState, StreamUpdate
from guidefield.messages.values import Positions


class StreamFacts:
    """The state of a stream as its client knows it, without asking the service; a subclass sets `_link`."""

    _link: StreamLink

    @property
    def stream_id(self) -> str:
        """Return its name."""
        return self._link.stream_id

    @property
    def position_names(self) -> list[str]:
        """Return the names of the columns of its pieces; none before it is open."""
        return [] if self._link.reply is None else list(self._link.reply.position_names)

    @property
    def now(self) -> float:
        """Return the time of the client's clock [s]."""
        return self._link.clock()

    @property
    def state(self) -> StreamState | None:
        """Return the last received state; None: none yet."""
        return self._link.state

    @property
    def ended(self) -> StreamState | None:
        """Return the state with which it ended; None: it is open, as far as is known."""
        return self._link.ended

    @property
    def late(self) -> int:
        """Return the number of pieces that came after their begin, and were ignored."""
        return self._link.execution.late

    def at(self, now: float) -> Motion:
        """Return the state of a robot that executes the pieces, at a time [s] that must not decrease."""
        return self._link.at(now)


END_WITHIN = 2.0  # time to wait for the answer to its end [s]

_R = TypeVar("_R")


class ServiceStream(StreamFacts):
    """A stream that a service answers; a context manager, which opens and ends it. `Client.stream` makes one.

    It has the methods of `Stream`, except that an update isn't answered at once: `update` sends it, `answer` waits for
    the answer, and iterating yields the pieces that came. It follows a robot that executes the pieces by the client's
    clock: `at` returns its state. Any thread may use it.

    Args:
        exchange: Asks and is answered.
        request: The request that opens it, or its fields.
        fields: Fields as in `StreamOpen`, instead of a request.
        clock: The client's clock [s]; None: seconds since now.

    Raises:
        MalformedRequest: if the request isn't one.
    """

    def __init__(
        self,
        exchange: Exchange,
        request: StreamOpen | dict[str, Any] | None,
        fields: dict[str, Any],
        clock: Callable[[], float] | None,
    ) -> None:
        self._exchange = exchange
        self._came = threading.Condition()
        self._link = StreamLink(exchange, request, fields, clock, self._wake)

    def __enter__(self) -> Self:
        self._open(self._link.start_opening())
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def update(self, update: StreamUpdate | dict[str, Any] | None = None, /, **fields: Any) -> float:
        """Send observations; don't wait for an answer.

        Args:
            update: The message; or its fields by name.
            fields: As in `StreamUpdate`. Without a `time` it is now; without `executing`, what a robot executes then
                that takes the pieces.

        Returns:
            Its time [s].

        Raises:
            MalformedRequest: if it is no update.
            GuidefieldError: why the stream has ended, if it has.
        """
        filled = self._link.complete_update(update, fields)
        self._link.send(filled)
        return filled.time

    def answer(self, within: float) -> Answer | None:
        """Wait for the answer to the last update up to a time [s]; None: none came.

        It is a piece, or the state that says why there is none; also that the stream has ended.
        """
        deadline = time.monotonic() + within
        with self._came:
            self._came.wait_for(lambda: self._link.answer() is not None, max(0.0, deadline - time.monotonic()))
            return self._link.answer()

    def __iter__(self) -> Iterator[Piece]:
        """Return the accepted pieces received since the last call."""
        yield from self._link.pieces()

    def aim_for(self, goal: StreamGoal | dict[str, Any] | None) -> int:
        """Change the goal; None: to stand. A goal also ends a stop.

        Returns:
            The goal's number, which its pieces have.

        Raises:
            InvalidGoal: if it can't be reached.
            GuidefieldError: if it is ill-posed otherwise, or the stream isn't open any more.
        """
        question, stream_goal = self._link.aim(goal)
        aimed: StreamAimed = self._ask(question)
        self._link.set_goal(stream_goal)
        return aimed.goal

    def judged(self, time: float | None = None) -> StreamJudged:
        """Ask whether the last piece and its stop are still proven by the last observations.

        Args:
            time: From when on, by the client's clock [s]; None: from now on.

        Raises:
            GuidefieldError: if that is no time, or the stream isn't open any more.
        """
        return self._ask(questions.judge_stream(self.stream_id, self.now if time is None else time))

    def stop(self) -> None:
        """Stop the robot: no piece follows the last one until there is a goal again."""
        self._ask(questions.stop_stream(self.stream_id))

    def read(self) -> StreamReply:
        """Read its state from the service."""
        return self._ask(questions.read_stream(self.stream_id))

    def reopen(self, start: Positions) -> None:
        """Open it again after its end, with the last goal and all declared obstacles, under another name.

        Args:
            start: Where the robot stands now, at rest.

        Raises:
            GuidefieldError: if it is refused.
        """
        self._open(self._link.start_reopening(start))

    def close(self) -> None:
        """End it; the last piece is executed to its end."""
        if self._link.ended is None and self._link.reply is not None:
            self._end_quickly()
        self._link.silence()

    def _open(self, question: Question[StreamReply]) -> None:
        try:
            self._link.accept(self._ask(question))
        except (KeyboardInterrupt, SystemExit):
            self._end_quickly()
            self._link.silence()
            raise
        except BaseException:
            self._link.silence()
            raise

    def _end_quickly(self) -> None:
        with contextlib.suppress(TimeoutError, GuidefieldError):
            self._exchange.ask(questions.end_stream(self.stream_id)).result(END_WITHIN)

    def _ask(self, question: Question[_R]) -> _R:
        return question.read(await_answer(self._exchange.ask(question)))

    def _wake(self) -> None:
        with self._came:
            self._came.notify_all()
