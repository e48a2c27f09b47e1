"""The client for asyncio: it waits for nothing but what its caller awaits."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Any, Literal, Self, TypeVar, cast

from guidefield.client import questions
from guidefield.client.async_streams import AsyncServiceStream
from guidefield.client.client import GIVE_UP_WITHIN, connect_exchange
from guidefield.client.exchange import Exchange
from guidefield.client.questions import KinematicsReply, Question
from guidefield.client.watching import watching, watching_scene
from guidefield.errors import GuidefieldError
from guidefield.messages import codec
from guidefield.messages.replies import (
    AnyRunReply,
    CertifyReply,
    Done,
    InfoReply,
    PlanReply,
    Progress,
    RobotReply,
    RobotsReply,
    RunsReply,
)
from guidefield.messages.requests import CertifyRequest, KinematicsRequest, PlanRequest
from guidefield.messages.scene import Obstacle, Scene
from guidefield.messages.scene_changes import SceneChanged
from guidefield.messages.store_requests import ReadRuns
from guidefield.messages.streams import StreamOpen
from guidefield.messages.values import Placement, RootJoint

_R = TypeVar("_R")
_T = TypeVar("_T")


class AsyncClient:
    """`Client`, for asyncio: the same questions, awaited; an asynchronous context manager, which closes it.

    Args:
        exchange: What carries the questions; the client closes it.
    """

    def __init__(self, exchange: Exchange) -> None:
        self._exchange = exchange

    @classmethod
    async def connect(
        cls,
        *endpoints: str,
        instance: str | None = None,
        config: Path | None = None,
        user: str | None = None,
        wait: float = 3.0,
    ) -> Self:
        """Connect to a service, as `Client.connect`."""
        return cls(await asyncio.to_thread(connect_exchange, endpoints, instance, config, user, wait))

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def close(self) -> None:
        """Close the session."""
        await asyncio.to_thread(self._exchange.close)

    @property
    def instance(self) -> str:
        """Name of the instance that is asked now."""
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
            request: The request; a run id is made where it has none.
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
            request: The request; a run id is made where it has none.
            progress: Is called, by the event loop, with how far the run is.
            fields: Those of a CertifyRequest, instead of a request.
        """
        return await self._run(questions.certify(request, fields), progress)

    async def _run(self, question: Question[_R], progress: Callable[[Progress], None] | None) -> _R:
        assert question.run_id is not None, "a run is asked for with a name"
        loop = asyncio.get_running_loop()
        hear = None if progress is None else _call_in_loop(loop, progress)
        with watching(self._exchange.session, self._exchange.user, question.run_id, hear):
            return await self._ask_or_cancel(question, questions.cancel(question.run_id))

    async def _ask_or_cancel(self, question: Question[_R], cancel: Question[Done]) -> _R:
        try:
            return await self._ask(question)
        except asyncio.CancelledError:
            with contextlib.suppress(TimeoutError, GuidefieldError):
                async with asyncio.timeout(GIVE_UP_WITHIN):
                    await self._ask(cancel)
            raise

    async def cancel(self, run_id: str) -> str:
        """End a run early: its reply is PREEMPTED, with the best by then; says in a sentence what that means."""
        return (await self._ask(questions.cancel(run_id))).done

    async def kinematics(self, request: KinematicsRequest | dict[str, Any]) -> KinematicsReply:
        """Ask for placements, configurations, clearances or potentials; the reply's kind is the request's."""
        question = questions.kinematics(request)
        assert question.request_id is not None, "kinematics is asked for with a name"
        return await self._ask_or_cancel(question, questions.cancel_request(question.request_id))

    async def cancel_request(self, request_id: str) -> str:
        """End a kinematics request early, by its `request_id`: the caller that waits for it gets `Preempted`."""
        return (await self._ask(questions.cancel_request(request_id))).done

    def stream(
        self,
        request: StreamOpen | dict[str, Any] | None = None,
        /,
        *,
        clock: Callable[[], float] | None = None,
        **fields: Any,
    ) -> AsyncServiceStream:
        """A stream of motion among obstacles that move, to be opened by ``async with``; as `Client.stream`."""
        return AsyncServiceStream(self._exchange, request, fields, clock)

    async def streams(self) -> list[str]:
        """The streams that are open, of this user."""
        return (await self._ask(questions.streams())).streams

    async def stream_recording(self, stream_id: str) -> bytes:
        """Return the recording of a stream, open or ended, as the bytes of an `.rrd` file."""
        return await self._ask(questions.stream_recording(stream_id))

    async def robots(self) -> RobotsReply:
        """The robots that can be named."""
        return await self._ask(questions.robots())

    async def robot(self, name: str) -> RobotReply:
        """One robot: joints, limits, frames, groups, collision pairs."""
        return await self._ask(questions.robot(name))

    async def store_robot(
        self,
        name: str,
        urdf: str,
        *,
        srdf: str | None = None,
        meshes: Mapping[str, bytes] | None = None,
        root_joint: RootJoint = "fixed",
    ) -> list[str]:
        """Store a robot of one's own under a name; `meshes` are files by the URIs that the URDF has for them."""
        return (await self._ask(questions.store_robot(name, urdf, srdf, meshes or {}, root_joint))).warnings

    async def delete_robot(self, name: str) -> None:
        """Forget a stored robot."""
        await self._ask(questions.delete_robot(name))

    async def scenes(self) -> list[str]:
        """The scenes that can be named."""
        return (await self._ask(questions.scenes())).scenes

    async def scene(self, name: str, version: int | None = None) -> Scene:
        """One scene: one of its last 16 versions, or the newest."""
        return (await self._ask(questions.scene(name, version))).scene

    async def scene_version(self, name: str) -> int | None:
        """Return the version of a scene; None for a scene of the package, which never changes."""
        return (await self._ask(questions.scene(name, None))).version

    async def store_scene(self, scene: Scene | dict[str, Any]) -> list[str]:
        """Store a scene under its own name; what is odd about its obstacles but harmless."""
        return (await self._ask(questions.store_scene(scene))).warnings

    async def change_scene(
        self,
        name: str,
        *,
        add: Sequence[Obstacle | dict[str, Any]] = (),
        move: Mapping[str, Placement | dict[str, Any]] = MappingProxyType({}),
        remove: Sequence[str] = (),
        version: int | None = None,
    ) -> int:
        """Change a stored scene, and return its new version. As `Client.change_scene`."""
        diff = {"add": list(add), "move": dict(move), "remove": list(remove), "version": version}
        return cast(int, (await self._ask(questions.change_scene(name, diff))).version)

    def watching_scene(
        self, name: str, hear: Callable[[SceneChanged], None]
    ) -> contextlib.AbstractContextManager[None]:
        """Hear what changes about a stored scene, as long as the block runs; the event loop calls `hear`."""
        loop = asyncio.get_running_loop()
        return watching_scene(self._exchange.session, self._exchange.user, name, _call_in_loop(loop, hear))

    def watching_run(self, run_id: str, hear: Callable[[Progress], None]) -> contextlib.AbstractContextManager[None]:
        """Hear how far a run is that was asked for elsewhere; the event loop calls `hear`."""
        loop = asyncio.get_running_loop()
        return watching(self._exchange.session, self._exchange.user, run_id, _call_in_loop(loop, hear))

    async def delete_scene(self, name: str) -> None:
        """Forget a stored scene."""
        await self._ask(questions.delete_scene(name))

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
        """The runs that are kept, newest first; the arguments are those of `Client.runs`."""
        filters = {"status": status, "robot": robot, "since": since, "text": text, "after": after}
        asked, joined = codec.convert(filters, ReadRuns), None
        while (question := questions.next_runs(asked, limit, joined)) is not None:
            joined = questions.join_runs(joined, await self._ask(question))
        assert joined is not None, "at least one page is asked for"
        return joined

    async def run(self, run_id: str) -> AnyRunReply:
        """One run: its request, and its reply once there is one."""
        return await self._ask(questions.run(run_id))

    async def delete_run(self, run_id: str) -> None:
        """Forget one run with its recording and proof."""
        await self._ask(questions.delete_run(run_id))

    async def recording(self, run_id: str) -> bytes:
        """The recording of one run, to be written to an `.rrd` file."""
        return await self._ask(questions.recording(run_id))

    async def proof(self, run_id: str) -> bytes:
        """The proof of one run that was asked for with `proof`, to be written to an `.npz` file."""
        return await self._ask(questions.proof(run_id))

    async def share(self, kind: Literal["runs", "scenes", "robots"], name: str) -> str:
        """Share a run, scene or robot with all users; return a sentence with its name for them."""
        return (await self._ask(questions.share(kind, name, shared=True))).done

    async def unshare(self, kind: Literal["runs", "scenes", "robots"], name: str) -> None:
        """End the sharing of a run, scene or robot; operators still read it."""
        await self._ask(questions.share(kind, name, shared=False))

    async def info(self) -> InfoReply:
        """Versions, the JSON Schema of every message, workers, queue, counters, latencies."""
        return await self._ask(questions.info())

    async def _ask(self, question: Question[_R]) -> _R:
        return question.read(await asyncio.wrap_future(self._exchange.ask(question)))


def _call_in_loop(loop: asyncio.AbstractEventLoop, hear: Callable[[_T], None]) -> Callable[[_T], None]:
    def call(message: _T) -> None:
        loop.call_soon_threadsafe(hear, message)

    return call
