"""The client whose methods wait for their answers; `asynchronous.py` has its counterpart for asyncio.

Names and arguments of methods are public. A new method asks a question of `questions.py`, and goes into both classes.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Any, Literal, Self, TypeVar

from guidefield.client import questions
from guidefield.client.exchange import Exchange, await_answer
from guidefield.client.questions import Question
from guidefield.client.session import ShownRuns, choose_viewer, connect_exchange
from guidefield.client.streams import ServiceStream
from guidefield.errors import GuidefieldError
from guidefield.messages import codec
from guidefield.messages.kinematics import KinematicsReply
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
from guidefield.messages.requests import CertifyRequest, KinematicsRequest, PlanRequest, ReadRuns
from guidefield.messages.scene import Obstacle, Scene
from guidefield.messages.scene_changes import SceneChanged
from guidefield.messages.streams import StreamOpen
from guidefield.messages.values import Placement, RootJoint

GIVE_UP_WITHIN = 2.0  # time to wait for the answer to a cancel when the caller is being interrupted [s]

_R = TypeVar("_R")


class Client:
    """A connection to the service; a context manager, which closes it.

    `Client.connect` makes one. Every question waits for its one answer, and any thread may ask. Where there are several
    instances, each plan and kinematics request goes to the freest, of those that have what this client stored and it
    names; stored robots, scenes and runs are an instance's own. The client imports no numeric package.

    Every method raises the exception that the service's ``reply_err`` names, and `NoService` where no service
    answers. A plan that was not found raises nothing: look at its `status`.

    Args:
        exchange: What carries the questions; the client closes it.
        viewer: Address of a running Rerun viewer that shows each run; None: none.

    Examples:
        >>> from guidefield import Client
        >>> goal = {"type": "joints", "positions": {"elbow_joint": 1.2}}
        >>> with Client.connect("tcp/127.0.0.1:7447") as client:
        ...     reply = client.plan(robot="ur5", scene="table", goal=goal, guide_planes=[])
        ...     kept = client.run(reply.run_id)
        >>> reply.status.name, kept.request.robot
        ('SUCCESS', 'ur5')
    """

    def __init__(self, exchange: Exchange, viewer: str | None = None) -> None:
        self._exchange, self._shown = exchange, ShownRuns(exchange, viewer)

    @classmethod
    def connect(
        cls,
        *endpoints: str,
        instance: str | None = None,
        config: Path | None = None,
        user: str | None = None,
        wait: float = 3.0,
        show: bool | str = False,
    ) -> Self:
        """Connect to a service.

        Args:
            endpoints: Where instances of it, or Zenoh routers, listen, such as ``tcp/127.0.0.1:7447``; several are
                connected to at once. None: those of the configuration, else a service on this machine.
            instance: The only instance to ask. None takes the one that has the least to do, and another one when that
                is gone or too busy.
            config: Zenoh configuration file: certificates, user and password.
            user: The user on whose keys to ask. None: the one that the configuration names, as the files of
                ``guidefield secure`` do; else the plain keys, without a user.
            wait: How long to wait for it to be there [s].
            show: Whether to show the recording of each run in Rerun's viewer on this machine, once it is rendered, or
                the address of another viewer. It is started if none runs, and needs the package rerun-sdk.

        Raises:
            CannotShow: if there is no viewer, and none can be started.
            NoService: if in that time nobody listens there, who listens doesn't let this user in, or no service of that
                name shows.
            ValueError: if an endpoint isn't one, or the configuration is wrong.
            MalformedRequest: if nobody can be a user of that name.
        """
        viewer = choose_viewer(show)
        return cls(connect_exchange(endpoints, instance, config, user, wait), viewer)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the session, once all runs are shown."""
        self._shown.close()
        self._exchange.close()

    @property
    def instance(self) -> str:
        """Return the name of the instance that gets the queries now."""
        return self._exchange.instance

    def alive(self) -> bool:
        """Return whether that instance is there now."""
        return self._exchange.alive()

    def plan(
        self,
        request: PlanRequest | dict[str, Any] | None = None,
        /,
        *,
        progress: Callable[[Progress], None] | None = None,
        **fields: Any,
    ) -> PlanReply:
        """Ask for a motion; give a request, or its fields by name.

        A request without a run id gets one. Interrupting the wait, as Ctrl-C does, ends the run.

        Args:
            progress: Is called, in another thread, with how far the run is.
            fields: Those of a PlanRequest, instead of a request.

        Returns:
            The plan, or an honest "no" with its reason: look at its `status`.

        Raises:
            MalformedRequest: if it isn't a plan request, or a request and fields are given.
            RequestTooLarge: if it is too long to be served.
            ServerBusy: if too much waits already.
            WorkerCrashed: if the process that worked on it died; the service lives on.
            GuidefieldError: whatever else is ill-posed about it, as `errors.py` lists.
        """
        return self._run(questions.plan(request, fields), progress)

    def certify(
        self,
        request: CertifyRequest | dict[str, Any] | None = None,
        /,
        *,
        progress: Callable[[Progress], None] | None = None,
        **fields: Any,
    ) -> CertifyReply:
        """Ask whether a motion is free and within limits; give a request, or its fields by name.

        A request without a run id gets one. Interrupting the wait, as Ctrl-C does, ends the run.

        Args:
            progress: Is called, in another thread, with how far the run is.
            fields: Those of a CertifyRequest, instead of a request.

        Returns:
            The verdict: look at its `status`.

        Raises:
            MalformedRequest: if it isn't a certify request, or a request and fields are given.
            GuidefieldError: as `plan`.
        """
        return self._run(questions.certify(request, fields), progress)

    def _run(self, question: Question[_R], progress: Callable[[Progress], None] | None) -> _R:
        assert question.run_id is not None, "a question for a run has its name"
        with self._exchange.watching_run(question.run_id, progress):
            reply = self._ask_or_cancel(question, questions.cancel(question.run_id))
        self._shown.add(reply)
        return reply

    def _ask_or_cancel(self, question: Question[_R], cancel: Question[Done]) -> _R:
        answer = self._exchange.ask(question)
        try:
            return question.read(await_answer(answer))
        except (KeyboardInterrupt, SystemExit):
            with contextlib.suppress(TimeoutError, GuidefieldError):
                self._exchange.ask(cancel).result(GIVE_UP_WITHIN)
            raise

    def cancel(self, run_id: str) -> str:
        """End a run early: its reply is PREEMPTED, with the best by then.

        Returns:
            A sentence that says what that means, also where no such run is under way.
        """
        return self._ask(questions.cancel(run_id)).done

    def kinematics(self, request: KinematicsRequest | dict[str, Any]) -> KinematicsReply:
        """Ask for placements, configurations, clearances or potentials.

        A request without a `request_id` gets one. Interrupting the wait, as Ctrl-C does, ends the request.

        Returns:
            The reply of the request's kind.

        Raises:
            InvalidConfiguration, InvalidGroup, UnknownFrame, RobotInvalid, SceneInvalid: if the request is ill-posed.
            MalformedRequest: if a dict is no kinematics request.
            TimedOut: if its `allowed_time` was up before all was answered.
            Preempted: if it was cancelled.
        """
        question = questions.kinematics(request)
        assert question.request_id is not None, "a question for kinematics has a name"
        return self._ask_or_cancel(question, questions.cancel_request(question.request_id))

    def cancel_request(self, request_id: str) -> str:
        """End a kinematics request early, by its `request_id`: the caller that waits for it gets `Preempted`.

        Returns:
            A sentence that says what that means, also where no such request is under way.
        """
        return self._ask(questions.cancel_request(request_id)).done

    def stream(
        self,
        request: StreamOpen | dict[str, Any] | None = None,
        /,
        *,
        clock: Callable[[], float] | None = None,
        **fields: Any,
    ) -> ServiceStream:
        """Return a stream of motion among moving obstacles, to be opened by ``with``.

        Args:
            clock: The clock that all its times are of [s]; None: seconds since now.

        Raises:
            MalformedRequest: if it doesn't open a stream, or a request and fields are given. When it is opened:
                `ServerBusy` where as many are open as may be, `QuotaExceeded` where this user has as many, and whatever
                is ill-posed about it.
        """
        return ServiceStream(self._exchange, request, fields, clock)

    def streams(self) -> list[str]:
        """List the names of this user's open streams."""
        return self._ask(questions.streams()).streams

    def stream_recording(self, stream_id: str) -> bytes:
        """Return the recording of a stream, open or ended, as the bytes of an `.rrd` file.

        Raises:
            UnknownObject: if nothing is kept of a stream of that name, or no update of it yet.
        """
        return self._ask(questions.stream_recording(stream_id))

    def robots(self) -> RobotsReply:
        """List the robots that can be named."""
        return self._ask(questions.robots())

    def robot(self, name: str) -> RobotReply:
        """Describe one robot: joints, limits, frames, groups, collision pairs.

        Args:
            name: Its name, as `robots` lists them.

        Raises:
            RobotInvalid: if there is none of that name, or it can't be used.
        """
        return self._ask(questions.robot(name))

    def store_robot(
        self,
        name: str,
        urdf: str,
        *,
        srdf: str | None = None,
        meshes: Mapping[str, bytes] | None = None,
        root_joint: RootJoint = "fixed",
    ) -> list[str]:
        """Store a robot, replacing an earlier one of its name; return warnings.

        Args:
            name: What to call it; not a name of the catalog.
            meshes: Mesh files, and what they name, by the URIs that the URDF and they have for them.
            root_joint: How its root link moves in the world.

        Raises:
            RobotInvalid: if it can't be used, or the name is the catalog's.
            RequestTooLarge: if it is too large, or too many are stored.
        """
        return self._ask(questions.store_robot(name, urdf, srdf=srdf, meshes=meshes, root_joint=root_joint)).warnings

    def delete_robot(self, name: str) -> None:
        """Forget a stored robot; raises RobotInvalid if none of that name is stored."""
        self._ask(questions.delete_robot(name))

    def scenes(self) -> list[str]:
        """List the names of scenes that can be used."""
        return self._ask(questions.scenes()).scenes

    def scene(self, name: str, version: int | None = None) -> Scene:
        """Return one scene.

        Args:
            name: Its name, as `scenes` lists them.
            version: One of its last 16 versions; None: the newest.

        Raises:
            SceneInvalid: if there is none of that name, or no such version.
        """
        return self._ask(questions.scene(name, version)).scene

    def scene_version(self, name: str) -> int | None:
        """Return a scene's version, None for one of the package, which never changes; SceneInvalid if there is none."""
        return self._ask(questions.scene(name)).version

    def store_scene(self, scene: Scene | dict[str, Any]) -> list[str]:
        """Store a scene, or the same as a dict, under its own name; return warnings.

        Raises:
            MalformedRequest: if a dict is no scene.
            SceneInvalid: if something in it can't be used, or the name is a packaged scene's.
        """
        return self._ask(questions.store_scene(scene)).warnings

    def change_scene(
        self,
        name: str,
        *,
        add: Sequence[Obstacle | dict[str, Any]] = (),
        move: Mapping[str, Placement | dict[str, Any]] = MappingProxyType({}),
        remove: Sequence[str] = (),
        version: int | None = None,
    ) -> int:
        """Change a stored scene, and return its new version.

        Args:
            add: Obstacles that come, or the same as dicts.
            move: Where obstacles stand from now on, by their names.
            remove: Names of obstacles that go, before others come: what is in both is replaced.
            version: The version that is meant: nothing changes if the scene has another by now. None: whichever.

        Raises:
            MalformedRequest: if a dict is no obstacle or placement.
            SceneInvalid: if nothing is stored under that name, the change does not fit, or another version was meant.

        Examples:
            >>> with guidefield.Client.connect() as client:  # doctest: +SKIP
            ...     client.change_scene("cell", move={"pallet": {"position": [0.8, 0.1, 0.0]}})
            7
        """
        changed = self._ask(questions.change_scene(name, add=add, move=move, remove=remove, version=version))
        return questions.changed_version(changed)

    def watching_scene(
        self, name: str, hear: Callable[[SceneChanged], None]
    ) -> contextlib.AbstractContextManager[None]:
        """Listen to the changes of a stored scene for as long as the block runs.

        Args:
            hear: Is called, in another thread, with each change and the version that it makes; what changed at the same
                time may come in another order.
        """
        return self._exchange.watching_scene(name, hear)

    def watching_run(self, run_id: str, hear: Callable[[Progress], None]) -> contextlib.AbstractContextManager[None]:
        """Listen to the progress of any run for as long as the block runs.

        Args:
            run_id: Its name; of another user's, which is shared, with the user before it: ``alice:r1``.
            hear: Is called, in another thread, with each progress report.
        """
        return self._exchange.watching_run(run_id, hear)

    def delete_scene(self, name: str) -> None:
        """Forget a stored scene; raises SceneInvalid if none of that name is stored."""
        self._ask(questions.delete_scene(name))

    def runs(
        self,
        *,
        status: str | None = None,
        robot: str | None = None,
        since: float | None = None,
        text: str | None = None,
        limit: int | None = None,
        after: str | None = None,
    ) -> RunsReply:
        """List the stored runs, newest first, on all pages.

        Args:
            status: Only those that ended so, by the name of a status.
            robot: Only those of a robot.
            since: Only those begun since then [s since 1970].
            text: Only those with this text in the message of their status.
            limit: The largest number of runs; None: no limit.
            after: Only those that follow in the list, by the `next` of an earlier reply; None: from the newest on.
        """
        filters = {"status": status, "robot": robot, "since": since, "text": text, "after": after}
        query, joined = codec.convert(filters, ReadRuns), None
        while (question := questions.next_runs(query, limit, joined)) is not None:
            joined = questions.join_runs(joined, self._ask(question))
        assert joined is not None, "there is at least one page"
        return joined

    def run(self, run_id: str) -> AnyRunReply:
        """Return a run's request, and its reply once there is one; UnknownObject if none of that name is kept."""
        return self._ask(questions.run(run_id))

    def delete_run(self, run_id: str) -> None:
        """Forget a run with its recording and proof; raises UnknownObject if none of that name is kept."""
        self._ask(questions.delete_run(run_id))

    def recording(self, run_id: str) -> bytes:
        """Return the recording of one run, to be written to an `.rrd` file.

        Raises:
            UnknownObject: if none of that name is kept, or it has no recording.
        """
        return self._ask(questions.recording(run_id))

    def proof(self, run_id: str) -> bytes:
        """Return the proof of one run that was requested with `proof`, to be written to an `.npz` file.

        Raises:
            UnknownObject: if none of that name is kept, or it has no proof.
        """
        return self._ask(questions.proof(run_id))

    def share(self, kind: Literal["runs", "scenes", "robots"], name: str) -> str:
        """Share a run, scene or robot with all users; return a sentence with its name for them."""
        return self._ask(questions.share(kind, name)).done

    def unshare(self, kind: Literal["runs", "scenes", "robots"], name: str) -> None:
        """End the sharing of a run, scene or robot; operators still read it."""
        self._ask(questions.unshare(kind, name))

    def info(self) -> InfoReply:
        """Return versions, the JSON Schema of every message, workers, queue, counters and latencies."""
        return self._ask(questions.info())

    def _ask(self, question: Question[_R]) -> _R:
        return question.read(await_answer(self._exchange.ask(question)))
