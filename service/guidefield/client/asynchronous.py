"""The client for asyncio, and its streams: the methods of `client.py` and `streams.py`, those that wait as coroutines.

What a method asks is the same question (`questions.py`) as its counterpart's: a new one goes into both classes. Only
`Client.alive` has no counterpart.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
from collections.abc import AsyncIterator, Callable, Coroutine
from pathlib import Path
from types import TracebackType
from typing import Any, Concatenate, ParamSpec, Self, TypeVar

from guidefield.client import questions
from guidefield.client.client import GIVE_UP_WITHIN, Client
from guidefield.client.exchange import Exchange
from guidefield.client.questions import Question
from guidefield.client.session import ShownRuns, choose_viewer, connect_exchange
from guidefield.client.stream_link import Answer, StreamLink
from guidefield.client.streams import END_WITHIN, StreamFacts
from guidefield.errors import GuidefieldError
from guidefield.messages import codec
from guidefield.messages.kinematics import KinematicsReply
from guidefield.messages.replies import CertifyReply, Done, PlanReply, Progress, RunsReply
from guidefield.messages.requests import CertifyRequest, KinematicsRequest, PlanRequest, ReadRuns
from guidefield.messages.scene_changes import SceneChanged
from guidefield.messages.stream_requests import StreamAimed, StreamJudged, StreamReply
from guidefield.messages.streams import Piece, StreamGoal, StreamOpen, StreamUpdate
from guidefield.messages.values import Positions

_P = ParamSpec("_P")
_R = TypeVar("_R")
_T = TypeVar("_T")


def _make_async(
    like: Callable[..., object], ask: Callable[_P, Question[_R]], part: Callable[[_R], _T]
) -> Callable[Concatenate[AsyncClient, _P], Coroutine[Any, Any, _T]]:
    async def method(self: AsyncClient, /, *given: _P.args, **named: _P.kwargs) -> _T:
        return part(await _ask(self._exchange, ask(*given, **named)))

    functools.update_wrapper(method, like)
    return method


def _whole(reply: _R) -> _R:
    return reply


async def _ask(exchange: Exchange, question: Question[_R]) -> _R:
    return question.read(await asyncio.wrap_future(exchange.ask(question)))


class AsyncClient:
    """`Client`, for asyncio: the same questions, awaited; an asynchronous context manager, which closes it.

    Args:
        exchange: What carries the questions; the client closes it.
        viewer: Address of a running Rerun viewer that shows each run; None: none.
    """

    def __init__(self, exchange: Exchange, viewer: str | None = None) -> None:
        self._exchange, self._shown = exchange, ShownRuns(exchange, viewer)

    @classmethod
    async def connect(
        cls,
        *endpoints: str,
        instance: str | None = None,
        config: Path | None = None,
        user: str | None = None,
        wait: float = 3.0,
        show: bool | str = False,
    ) -> Self:
        """Connect to a service, as `Client.connect`."""
        viewer = await asyncio.to_thread(choose_viewer, show)
        return cls(await asyncio.to_thread(connect_exchange, endpoints, instance, config, user, wait), viewer)

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def close(self) -> None:
        """Close the session, once all runs are shown."""
        await asyncio.to_thread(self._shown.close)
        await asyncio.to_thread(self._exchange.close)

    @property
    def instance(self) -> str:
        """Name of the instance that gets the queries now."""
        return self._exchange.instance

    async def plan(
        self,
        request: PlanRequest | dict[str, Any] | None = None,
        /,
        *,
        progress: Callable[[Progress], None] | None = None,
        **fields: Any,
    ) -> PlanReply:
        """Ask for a motion; give a request, or its fields by name. A task that is cancelled here ends the run.

        Args:
            progress: Is called, by the event loop, with how far the run is.
            fields: Those of a PlanRequest, instead of a request.
        """
        return await self._run(questions.plan(request, fields), progress)

    async def certify(
        self,
        request: CertifyRequest | dict[str, Any] | None = None,
        /,
        *,
        progress: Callable[[Progress], None] | None = None,
        **fields: Any,
    ) -> CertifyReply:
        """Ask whether a motion is free and within limits, as `Client.certify`; a task that is cancelled ends the run.

        Args:
            progress: Is called, by the event loop, with how far the run is.
            fields: Those of a CertifyRequest, instead of a request.
        """
        return await self._run(questions.certify(request, fields), progress)

    async def _run(self, question: Question[_R], progress: Callable[[Progress], None] | None) -> _R:
        assert question.run_id is not None, "a question for a run has its name"
        hear = None if progress is None else _call_in_loop(progress)
        with self._exchange.watching_run(question.run_id, hear):
            reply = await self._ask_or_cancel(question, questions.cancel(question.run_id))
        self._shown.add(reply)
        return reply

    async def _ask_or_cancel(self, question: Question[_R], cancel: Question[Done]) -> _R:
        try:
            return await _ask(self._exchange, question)
        except asyncio.CancelledError:
            with contextlib.suppress(TimeoutError, GuidefieldError):
                async with asyncio.timeout(GIVE_UP_WITHIN):
                    await _ask(self._exchange, cancel)
            raise

    async def kinematics(self, request: KinematicsRequest | dict[str, Any]) -> KinematicsReply:
        """Ask for placements, configurations, clearances or potentials; the reply's kind is the request's."""
        question = questions.kinematics(request)
        assert question.request_id is not None, "a question for kinematics has a name"
        return await self._ask_or_cancel(question, questions.cancel_request(question.request_id))

    def stream(
        self,
        request: StreamOpen | dict[str, Any] | None = None,
        /,
        *,
        clock: Callable[[], float] | None = None,
        **fields: Any,
    ) -> AsyncServiceStream:
        """Return a stream of motion among moving obstacles, to be opened by ``async with``; as `Client.stream`."""
        return AsyncServiceStream(self._exchange, request, fields, clock)

    def watching_scene(
        self, name: str, hear: Callable[[SceneChanged], None]
    ) -> contextlib.AbstractContextManager[None]:
        """Listen to the changes of a stored scene for as long as the block runs; the event loop calls `hear`."""
        return self._exchange.watching_scene(name, _call_in_loop(hear))

    def watching_run(self, run_id: str, hear: Callable[[Progress], None]) -> contextlib.AbstractContextManager[None]:
        """Listen to the progress of any run for as long as the block runs; the event loop calls `hear`."""
        return self._exchange.watching_run(run_id, _call_in_loop(hear))

    async def runs(
        self,
        *,
        status: str | None = None,
        robot: str | None = None,
        since: float | None = None,
        text: str | None = None,
        limit: int | None = None,
        after: str | None = None,
    ) -> RunsReply:
        """List the runs that are kept, newest first; the arguments are those of `Client.runs`."""
        filters = {"status": status, "robot": robot, "since": since, "text": text, "after": after}
        query, joined = codec.convert(filters, ReadRuns), None
        while (question := questions.next_runs(query, limit, joined)) is not None:
            joined = questions.join_runs(joined, await _ask(self._exchange, question))
        assert joined is not None, "there is at least one page"
        return joined

    cancel = _make_async(Client.cancel, questions.cancel, lambda reply: reply.done)
    cancel_request = _make_async(Client.cancel_request, questions.cancel_request, lambda reply: reply.done)
    streams = _make_async(Client.streams, questions.streams, lambda reply: reply.streams)
    stream_recording = _make_async(Client.stream_recording, questions.stream_recording, _whole)
    robots = _make_async(Client.robots, questions.robots, _whole)
    robot = _make_async(Client.robot, questions.robot, _whole)
    store_robot = _make_async(Client.store_robot, questions.store_robot, lambda reply: reply.warnings)
    delete_robot = _make_async(Client.delete_robot, questions.delete_robot, lambda _: None)
    scenes = _make_async(Client.scenes, questions.scenes, lambda reply: reply.scenes)
    scene = _make_async(Client.scene, questions.scene, lambda reply: reply.scene)
    scene_version = _make_async(Client.scene_version, questions.scene, lambda reply: reply.version)
    store_scene = _make_async(Client.store_scene, questions.store_scene, lambda reply: reply.warnings)
    change_scene = _make_async(Client.change_scene, questions.change_scene, questions.changed_version)
    delete_scene = _make_async(Client.delete_scene, questions.delete_scene, lambda _: None)
    run = _make_async(Client.run, questions.run, _whole)
    delete_run = _make_async(Client.delete_run, questions.delete_run, lambda _: None)
    recording = _make_async(Client.recording, questions.recording, _whole)
    proof = _make_async(Client.proof, questions.proof, _whole)
    share = _make_async(Client.share, questions.share, lambda reply: reply.done)
    unshare = _make_async(Client.unshare, questions.unshare, lambda _: None)
    info = _make_async(Client.info, questions.info, _whole)


def _call_in_loop(hear: Callable[[_T], None]) -> Callable[[_T], None]:
    loop = asyncio.get_running_loop()

    def call(message: _T) -> None:
        loop.call_soon_threadsafe(hear, message)

    return call


class AsyncServiceStream(StreamFacts):
    """`ServiceStream`, for asyncio; an asynchronous context manager, which opens and ends it.

    `async for` yields the pieces that a robot takes, until the stream has ended.

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
        """Send observations, as `ServiceStream.update`, without waiting for an answer; return their time [s]."""
        filled = self._link.complete_update(update, fields)
        if filled.declare or filled.gone:
            await asyncio.to_thread(self._link.send, filled)
        else:
            self._link.send(filled)
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
        """Yield the pieces that a robot takes, as they come, until the stream has ended."""
        while True:
            for piece in self._link.pieces():
                yield piece
            if self._link.ended is not None:
                return
            await self._next()

    async def aim_for(self, goal: StreamGoal | dict[str, Any] | None) -> int:
        """Change the goal, as `ServiceStream.aim_for`; return its number."""
        question, stream_goal = self._link.aim(goal)
        aimed: StreamAimed = await _ask(self._exchange, question)
        self._link.set_goal(stream_goal)
        return aimed.goal

    async def judged(self, time: float | None = None) -> StreamJudged:
        """Return whether the last piece and its stop are still proven, as `ServiceStream.judged`."""
        judge = questions.judge_stream(self.stream_id, self.now if time is None else time)
        return await _ask(self._exchange, judge)

    async def stop(self) -> None:
        """Stop the robot: no piece follows the last one until there is a goal again."""
        await _ask(self._exchange, questions.stop_stream(self.stream_id))

    async def read(self) -> StreamReply:
        """Read its state from the service."""
        return await _ask(self._exchange, questions.read_stream(self.stream_id))

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
            self._link.accept(await _ask(self._exchange, question))
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
                await _ask(self._exchange, questions.end_stream(self.stream_id))

    async def _next(self) -> None:
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
