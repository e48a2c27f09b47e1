"""A light Python client: typed requests in, typed replies out, over Zenoh."""

from __future__ import annotations

import json
import time
import uuid
from collections.abc import Mapping
from types import TracebackType
from typing import Any, Self, TypeVar

import msgspec
import zenoh

from guidefield.errors import ERRORS, GuidefieldError, InternalFailure, MalformedRequest, NoService
from guidefield.messages import codec, requests
from guidefield.messages.codec import Encoding
from guidefield.messages.replies import (
    ClearanceReply,
    Done,
    ErrorReply,
    ForwardKinematicsReply,
    InfoReply,
    InverseKinematicsReply,
    PlanReply,
    PointPotentialReply,
    RobotPotentialReply,
    RobotReply,
    RobotsReply,
    RunReply,
    RunsReply,
    SceneReply,
    ScenesReply,
)
from guidefield.messages.requests import KinematicsRequest, PlanRequest
from guidefield.messages.scene import Scene
from guidefield.messages.values import Reply, RootJoint

KinematicsReply = (
    ForwardKinematicsReply | InverseKinematicsReply | ClearanceReply | PointPotentialReply | RobotPotentialReply
)

ANSWER_TIMEOUT = 660.0
"""How long an answer to anything but a plan is waited for; longer than the service lets a worker work [s]."""
PLAN_MARGIN = 90.0
"""How much longer than its planning time the answer to a plan is waited for; more than the service's own margin [s]."""
LOOK_AGAIN = 0.05
"""How often a service that isn't there yet is looked for [s]."""

_R = TypeVar("_R", bound=Reply)
_ERRORS = {int(code): kind for code, kind in ERRORS.items()}


class Client:
    """A connection to one instance of the service; a context manager, which closes it.

    Whatever is asked raises the exception that the service's ``reply_err`` stands for, and NoService where nobody
    answers.

    Args:
        session: An open Zenoh session; the client closes it.
        instance: Name of the service.
    """

    def __init__(self, session: zenoh.Session, instance: str = "local") -> None:
        self._session = session
        self._instance = instance

    @classmethod
    def connect(cls, *endpoints: str, instance: str = "local", wait: float = 3.0) -> Self:
        """Connect to a service.

        Args:
            endpoints: Where it, or a Zenoh router, listens; such as ``tcp/127.0.0.1:7447``.
            instance: Its name.
            wait: How long to wait for it to be there [s].

        Raises:
            NoService: if in that time nobody listens there, or no service of that name shows.
            ValueError: if an endpoint isn't one.
        """
        deadline = time.monotonic() + wait
        client = cls(_open(endpoints, deadline), instance)
        try:
            while not client.alive():
                if time.monotonic() > deadline:
                    raise NoService(f"no service named {instance!r} at {', '.join(endpoints)}", instance=instance)
                time.sleep(LOOK_AGAIN)
        except BaseException:
            client.close()
            raise
        return client

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the session."""
        self._session.close()

    def alive(self) -> bool:
        """Whether the service is there now."""
        tokens = self._session.liveliness().get(f"guidefield/{self._instance}/alive", timeout=1.0)
        return any(token.ok is not None for token in tokens)

    def plan(self, request: PlanRequest | dict[str, Any] | None = None, /, **fields: Any) -> PlanReply:
        """Ask for a motion; give a request, or its fields by name.

        A run id is made where the request has none.
        """
        given = codec.decode_request(fields if request is None else request)
        if not isinstance(given, PlanRequest):
            raise MalformedRequest(f"a plan is asked for with a PlanRequest, not with {type(given).__name__}")
        if given.run_id is None:
            given = msgspec.structs.replace(given, run_id=uuid.uuid4().hex)
        return self._ask("plan", PlanReply, given, timeout=given.allowed_planning_time + PLAN_MARGIN)

    def kinematics(self, request: KinematicsRequest) -> KinematicsReply:
        """Ask for placements, configurations, clearances or potentials; the reply's kind is the request's."""
        return self._ask("kinematics", _kinematics_reply(request), request)

    def robots(self) -> RobotsReply:
        """The robots that can be named."""
        return self._ask("robots", RobotsReply)

    def robot(self, name: str) -> RobotReply:
        """One robot: joints, limits, frames, groups, collision pairs."""
        return self._ask(f"robots/{name}", RobotReply)

    def store_robot(
        self,
        name: str,
        urdf: str,
        *,
        srdf: str | None = None,
        meshes: Mapping[str, bytes] | None = None,
        root_joint: RootJoint = "fixed",
    ) -> None:
        """Store a robot of one's own under a name; `meshes` are files by the URIs that the URDF has for them."""
        files = requests.RobotFiles(urdf=urdf, srdf=srdf, meshes=dict(meshes or {}), root_joint=root_joint)
        self._ask(f"robots/{name}", Done, files)

    def delete_robot(self, name: str) -> None:
        """Forget a stored robot."""
        self._ask(f"robots/{name}?delete", Done)

    def scenes(self) -> list[str]:
        """The scenes that can be named."""
        return self._ask("scenes", ScenesReply).scenes

    def scene(self, name: str) -> Scene:
        """One scene."""
        return self._ask(f"scenes/{name}", SceneReply).scene

    def store_scene(self, scene: Scene) -> None:
        """Store a scene under its own name."""
        self._ask(f"scenes/{scene.name}", Done, scene)

    def delete_scene(self, name: str) -> None:
        """Forget a stored scene."""
        self._ask(f"scenes/{name}?delete", Done)

    def runs(self, *, status: str | None = None, robot: str | None = None, since: float | None = None) -> RunsReply:
        """The runs that are kept, newest first: those of a status or robot, or begun since a time [s since 1970]."""
        filters = {"status": status, "robot": robot, "since": since}
        given = ";".join(f"{name}={value}" for name, value in filters.items() if value is not None)
        return self._ask(f"runs?{given}" if given else "runs", RunsReply)

    def run(self, run_id: str) -> RunReply:
        """One run: its request, and its reply once there is one."""
        return self._ask(f"runs/{run_id}", RunReply)

    def delete_run(self, run_id: str) -> None:
        """Forget one run with its recording."""
        self._ask(f"runs/{run_id}?delete", Done)

    def recording(self, run_id: str) -> bytes:
        """The recording of one run, to be written to an `.rrd` file."""
        return self._payload(f"runs/{run_id}/recording", None, ANSWER_TIMEOUT)

    def info(self) -> InfoReply:
        """Versions, the JSON Schema of every message, workers, queue, counters."""
        return self._ask("info", InfoReply)

    def _ask(
        self, key: str, kind: type[_R], message: msgspec.Struct | None = None, timeout: float = ANSWER_TIMEOUT
    ) -> _R:
        payload = self._payload(key, message, timeout)
        try:
            return msgspec.msgpack.decode(payload, type=kind)
        except msgspec.DecodeError as error:
            raise InternalFailure(f"the answer at {key!r} is no {kind.__name__}: {error}", key=key) from error

    def _payload(self, key: str, message: msgspec.Struct | None, timeout: float) -> bytes:
        payload = None if message is None else codec.encode(message, Encoding.MSGPACK)
        try:
            selector = zenoh.Selector(f"guidefield/{self._instance}/{key}")
        except zenoh.ZError as error:
            raise MalformedRequest(f"{key!r} can't be asked for: {error}", key=key) from None
        encoding = Encoding.MSGPACK.value
        answers = list(self._session.get(selector, payload=payload, encoding=encoding, timeout=timeout))
        if not answers:
            raise NoService(f"no service named {self._instance!r} answers any more", instance=self._instance)
        if answers[0].ok is None:
            raise _error(answers[0].err, timeout)
        return bytes(answers[0].ok.payload.to_bytes())


def _open(endpoints: tuple[str, ...], deadline: float) -> zenoh.Session:
    """A session that talks to these endpoints and to nobody else."""
    config = zenoh.Config()
    try:
        config.insert_json5("connect/endpoints", json.dumps(endpoints))
    except zenoh.ZError as error:
        raise ValueError(f"endpoints are written like tcp/127.0.0.1:7447, got {', '.join(endpoints)}") from error
    config.insert_json5("mode", json.dumps("client"))
    for scouting in ("multicast", "gossip"):
        config.insert_json5(f"scouting/{scouting}/enabled", "false")
    while True:
        try:
            return zenoh.open(config)
        except zenoh.ZError as error:
            if time.monotonic() > deadline:
                raise NoService(
                    f"nobody listens at {', '.join(endpoints)}: {error}", endpoints=list(endpoints)
                ) from None
        time.sleep(LOOK_AGAIN)


def _kinematics_reply(request: KinematicsRequest) -> type[KinematicsReply]:
    match request:
        case requests.ForwardKinematics():
            return ForwardKinematicsReply
        case requests.InverseKinematics():
            return InverseKinematicsReply
        case requests.Clearance():
            return ClearanceReply
        case requests.Potential(points=None):
            return RobotPotentialReply
        case requests.Potential():
            return PointPotentialReply


def _error(answer: Any, timeout: float) -> GuidefieldError:
    """The exception that an answer stands for; Zenoh itself answers, in words, where the time is up."""
    payload = answer.payload.to_bytes()
    try:
        error = msgspec.msgpack.decode(payload, type=ErrorReply)
    except msgspec.DecodeError:
        return NoService(f"no answer within {timeout:g} s ({payload.decode(errors='replace')})", timeout=timeout)
    return _ERRORS.get(error.code, InternalFailure)(error.message, **error.details)
