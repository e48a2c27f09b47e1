"""A stream that a service answers, for asyncio."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable
from types import TracebackType
from typing import Any, Self, TypeVar

from guidefield.client import questions
from guidefield.client.exchange import Exchange
from guidefield.client.questions import Question
from guidefield.client.stream_link import Answer, StreamLink
from guidefield.client.streams import END_WITHIN, StreamFacts
from guidefield.errors import GuidefieldError
from guidefield.messages.goals import Positions
from guidefield.messages.stream_requests import StreamAimed, StreamJudged, StreamReply
from guidefield.messages.streams import Piece, StreamGoal, StreamOpen, StreamUpdate

_R = TypeVar("_R")


class AsyncServiceStream(StreamFacts):
    """`ServiceStream`, for asyncio; an asynchronous context manager, which opens and ends it.

    `async for` waits for the pieces that a robot takes, until the stream has ended.

    Args:
        exchange: Asks and is answered.
        request: What is asked, or its fields.
        fields: As in `StreamOpen`, instead of a request.
        clock: The client's clock [s]; None: seconds since now.

    Raises:
        MalformedRequest: if that can't be asked for.
    """

    def __init__(
        self,
        exchange: Exchange,
        request: StreamOpen | dict[str, Any] | None,
        fields: dict[str, Any],
        clock: Callable[[], float] | None,
    ) -> None:
        self._exchange = exchange
        self._loop = asyncio.get_running_loop()
        self._awaited: set[asyncio.Future[None]] = set()
        self._link = StreamLink(exchange, request, fields, clock, self._wake)

    async def __aenter__(self) -> Self:
        await self._open(self._link.start_opening())
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def update(self, update: StreamUpdate | dict[str, Any] | None = None, /, **fields: Any) -> float:
        """Send what is seen, as `ServiceStream.update`; waits for no answer. Its time [s]."""
        filled = self._link.complete_update(update, fields)
        if filled.declare or filled.gone:
            await asyncio.to_thread(self._link.put, filled)
        else:
            self._link.put(filled)
        return filled.time

    async def answer(self, within: float) -> Answer | None:
        """Wait for the answer to the last update up to a time [s]; None: none came."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(within):
                while (answer := self._link.answer()) is None:
                    await self._next()
                return answer
        return self._link.answer()

    async def __aiter__(self) -> AsyncIterator[Piece]:
        """The pieces that a robot takes, as they come, until the stream has ended."""
        while True:
            for piece in self._link.pieces():
                yield piece
            if self._link.ended is not None:
                return
            await self._next()

    async def aim_for(self, goal: StreamGoal | dict[str, Any] | None) -> int:
        """Change the goal, as `ServiceStream.aim_for`; its number."""
        question, asked = self._link.aim(goal)
        aimed: StreamAimed = await self._ask(question)
        self._link.set_goal(asked)
        return aimed.goal

    async def judged(self, time: float | None = None) -> StreamJudged:
        """Return whether the last piece and its stop are still proven, as `ServiceStream.judged`."""
        return await self._ask(questions.judge_stream(self.stream_id, self.now if time is None else time))

    async def stop(self) -> None:
        """Stop the robot: no piece follows the last one until there is a goal again."""
        await self._ask(questions.stop_stream(self.stream_id))

    async def read(self) -> StreamReply:
        """Read its state from the service."""
        return await self._ask(questions.read_stream(self.stream_id))

    async def reopen(self, start: Positions) -> None:
        """Open it again after it has ended, from where the robot stands, as `ServiceStream.reopen`."""
        await self._open(self._link.start_reopening(start))

    async def close(self) -> None:
        """End it; the last piece is executed to its end."""
        if self._link.ended is None and self._link.reply is not None:
            await self._end_quickly()
        self._link.silence()

    async def _open(self, question: Question[StreamReply]) -> None:
        try:
            self._link.accept(await self._ask(question))
        except asyncio.CancelledError:
            await self._end_quickly()
            self._link.silence()
            raise
        except BaseException:
            self._link.silence()
            raise

    async def _end_quickly(self) -> None:
        with contextlib.suppress(TimeoutError, GuidefieldError):
            async with asyncio.timeout(END_WITHIN):
                await self._ask(questions.end_stream(self.stream_id))

    async def _ask(self, question: Question[_R]) -> _R:
        return question.read(await asyncio.wrap_future(self._exchange.ask(question)))

    async def _next(self) -> None:
        """Wait until something more came."""
        came: asyncio.Future[None] = self._loop.create_future()
        self._awaited.add(came)
        try:
            await came
        finally:
            self._awaited.discard(came)

    def _wake(self) -> None:
        with contextlib.suppress(RuntimeError):  # the loop is closed, and nobody waits
            self._loop.call_soon_threadsafe(self._wake_all)

    def _wake_all(self) -> None:
        for came in self._awaited:
            if not came.done():
                came.set_result(None)
