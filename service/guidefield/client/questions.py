"""The questions of a client: key, payload and reader of the reply of each, without a network.

Both clients make their methods of these; keys, parameters and messages are the wire's (`messages/keys.py`).
"""

from __future__ import annotations

import re
import uuid
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Generic, Literal, TypeVar, cast

import msgspec

from guidefield.errors import GuidefieldError, InternalFailure, MalformedRequest, RequestTooLarge
from guidefield.messages import codec, requests
from guidefield.messages.codec import Encoding
from guidefield.messages.kinematics import KinematicsReply, kinematics_reply_kind
from guidefield.messages.replies import (
    CERTIFY,
    AnyRunReply,
    CertifyReply,
    Done,
    ErrorReply,
    InfoReply,
    PlanReply,
    RobotReply,
    RobotsReply,
    RunReply,
    RunsReply,
    SceneReply,
    ScenesReply,
    make_error,
    run_reply_kind,
)
from guidefield.messages.requests import (
    LARGEST_PAGE,
    CertifyRequest,
    KinematicsRequest,
    MotionRequest,
    PlanRequest,
    ReadRuns,
)
from guidefield.messages.scene import Obstacle, Scene
from guidefield.messages.scene_changes import RequestScene, SceneDiff
from guidefield.messages.stream_requests import (
    StreamAim,
    StreamAimed,
    StreamJudge,
    StreamJudged,
    StreamReply,
    StreamsReply,
)
from guidefield.messages.streams import StreamGoal, StreamOpen
from guidefield.messages.values import Placement, Reply, RootJoint

ANSWER_TIMEOUT = 660.0
"""Time to wait for an answer to anything but a run and kinematics [s].

It must be longer than the service may take: `STORE_TIME_LIMIT` of `messages/keys.py` with `BACKSTOP` of
`pool/waiting.py`, and `OPENED_WITHIN` of `endpoint/streams.py`.
"""
_DEFAULT_FILTERS = (None, LARGEST_PAGE)
"""Values in a request for a list of runs that are the defaults, and left out."""
PLAN_MARGIN = 90.0
"""Time to wait for the answer to a run or kinematics beyond its allowed time [s].

It must be longer than the service's own margin, `BACKSTOP` of `pool/waiting.py`: then the service tells of the fault.
"""
_WORD = re.compile(r"[^/?#*$;]+")  # one chunk of a key, or the value of a parameter

_R = TypeVar("_R")
_Q = TypeVar("_Q", PlanRequest, CertifyRequest, StreamOpen)
_M = TypeVar("_M", bound=Reply)


@dataclass(frozen=True)
class Question(Generic[_R]):
    """A query to a service.

    Attributes:
        key: Below the instance's, with parameters.
        read: Decodes the reply.
        payload: Its message, if any.
        timeout: Time to wait for the answer [s].
        run_id: The run that it is about, if any.
        request_id: The kinematics request or stream that it is about, if any.
        work: Whether any instance can answer it, so that the least busy one does.
        needs: Keys of stored scenes and robots that it names.
        stores, forgets: Key of the scene or robot that it stores or deletes.
        repeatable: Whether it may be sent again after its answer was lost, because the answer is the same then.
    """

    key: str
    read: Callable[[bytes], _R]
    payload: bytes | None = None
    timeout: float = ANSWER_TIMEOUT
    run_id: str | None = None
    request_id: str | None = None
    repeatable: bool = True
    work: bool = False
    needs: tuple[str, ...] = ()
    stores: str | None = None
    forgets: str | None = None

    @property
    def own_id(self) -> str | None:
        """Return the id of its run, request or stream, if any; further questions about that go to the same instance."""
        return self.run_id or self.request_id


def plan(request: PlanRequest | dict[str, Any] | None, fields: dict[str, Any]) -> Question[PlanReply]:
    """Make the question for a plan, from a request or its fields; a request without a run id gets one.

    Raises MalformedRequest if that isn't a plan request, or both are given.
    """
    given = codec.decode_request(_take_either("plan", request, fields))
    if not isinstance(given, PlanRequest):
        raise MalformedRequest(f"a plan is asked for with a PlanRequest, not with {type(given).__name__}")
    return _run("plan", given, given.allowed_planning_time, PlanReply)


def certify(request: CertifyRequest | dict[str, Any] | None, fields: dict[str, Any]) -> Question[CertifyReply]:
    """Make the question for a verdict, from a request or its fields; a request without a run id gets one.

    Raises MalformedRequest if that isn't a certify request, or both are given.
    """
    content = _take_either("certify", request, fields)
    given = codec.decode_request({"type": CERTIFY, **content} if isinstance(content, dict) else content)
    if not isinstance(given, CertifyRequest):
        raise MalformedRequest(f"a judgement is asked for with a CertifyRequest, not with {type(given).__name__}")
    return _run("certify", given, given.allowed_time, CertifyReply)


def kinematics(request: KinematicsRequest | dict[str, Any]) -> Question[KinematicsReply]:
    """Make the question for a kinematics request; raises MalformedRequest if the dict isn't a kinematics request."""
    given = codec.convert(request, KinematicsRequest) if isinstance(request, dict) else request
    request_id = given.request_id or uuid.uuid4().hex
    named = msgspec.structs.replace(given, request_id=request_id)
    read, timeout = _make_reader("kinematics", kinematics_reply_kind(given)), given.allowed_time + PLAN_MARGIN
    return Question(
        "kinematics", read, _encode(named), timeout, request_id=request_id, work=True, needs=_list_needs(given)
    )


def robots() -> Question[RobotsReply]:
    """List the robots that can be named."""
    return _make_reading("robots", RobotsReply)


def robot(name: str) -> Question[RobotReply]:
    """Describe one robot."""
    return _make_reading(_key("robots", name), RobotReply)


def store_robot(
    name: str,
    urdf: str,
    *,
    srdf: str | None = None,
    meshes: Mapping[str, bytes] | None = None,
    root_joint: RootJoint = "fixed",
) -> Question[Done]:
    """Store a robot."""
    files = requests.RobotFiles(urdf=urdf, srdf=srdf, meshes=dict(meshes or {}), root_joint=root_joint)
    key = _key("robots", name)
    return Question(key, _make_reader(key, Done), _encode(files), stores=key)


def delete_robot(name: str) -> Question[Done]:
    """Delete a stored robot."""
    return _make_deleting(_key("robots", name))


def scenes() -> Question[ScenesReply]:
    """List the scenes that can be named."""
    return _make_reading("scenes", ScenesReply)


def scene(name: str, version: int | None = None) -> Question[SceneReply]:
    """Read one scene, the newest version or another one."""
    key = _key("scenes", name)
    return _make_reading(key if version is None else f"{key}?version={version}", SceneReply)


def store_scene(scene: Scene | dict[str, Any]) -> Question[Done]:
    """Store a scene under its own name; raises MalformedRequest if the dict isn't a scene."""
    given = codec.convert(scene, Scene) if isinstance(scene, dict) else scene
    key = _key("scenes", given.name)
    return Question(key, _make_reader(key, Done), _encode(given), stores=key)


def change_scene(
    name: str,
    *,
    add: Sequence[Obstacle | dict[str, Any]] = (),
    move: Mapping[str, Placement | dict[str, Any]] = MappingProxyType({}),
    remove: Sequence[str] = (),
    version: int | None = None,
) -> Question[Done]:
    """Change a stored scene; never sent again, since it would be changed twice.

    Raises MalformedRequest if an obstacle or placement isn't one.
    """
    diff = {"add": list(add), "move": dict(move), "remove": list(remove), "version": version}
    given = codec.convert({"type": "scene_diff", **diff}, SceneDiff)
    key = _key("scenes", name)
    return Question(key, _make_reader(key, Done), _encode(given), needs=(key,), repeatable=False)


def changed_version(changed: Done) -> int:
    """Return the version of a scene that was changed."""
    return cast(int, changed.version)


def delete_scene(name: str) -> Question[Done]:
    """Delete a stored scene."""
    return _make_deleting(_key("scenes", name))


def runs(filters: ReadRuns) -> Question[RunsReply]:
    """List a page of the stored runs; raises MalformedRequest if a filter has characters that a query can't hold."""
    given = {name: value for name, value in msgspec.structs.asdict(filters).items() if value not in _DEFAULT_FILTERS}
    if ";" in given.get("text", ""):
        raise MalformedRequest("`text` can't be asked for with a semicolon in it", parameter="text")
    words = ";".join(f"{name}={value if name == 'text' else _word(value)}" for name, value in given.items())
    return _make_reading(f"runs?{words}" if words else "runs", RunsReply)


def next_runs(filters: ReadRuns, limit: int | None, joined: RunsReply | None) -> Question[RunsReply] | None:
    """Ask for the next page of a list of at most `limit` runs, after the joined ones; None if the list is complete."""
    rest = None if limit is None else limit - (0 if joined is None else len(joined.runs))
    if joined is not None and (rest == 0 or joined.next is None):
        return None
    page = LARGEST_PAGE if rest is None else min(rest, LARGEST_PAGE)
    after = filters.after if joined is None else joined.next
    return runs(msgspec.structs.replace(filters, limit=page, after=after))


def join_runs(joined: RunsReply | None, page: RunsReply) -> RunsReply:
    """Return pages of a list and the one after them as one."""
    return page if joined is None else msgspec.structs.replace(page, runs=[*joined.runs, *page.runs])


def run(run_id: str) -> Question[AnyRunReply]:
    """Read one run."""
    key = _key("runs", run_id)

    def read(payload: bytes) -> AnyRunReply:
        try:
            kind = run_reply_kind(payload, msgspec.msgpack.decode)
        except msgspec.DecodeError:
            kind = RunReply  # whose reader says what is wrong with it
        return _make_reader(key, kind)(payload)

    return Question(key, read, run_id=run_id)


def delete_run(run_id: str) -> Question[Done]:
    """Delete a run."""
    return _make_deleting(_key("runs", run_id), run_id)


def cancel(run_id: str) -> Question[Done]:
    """Cancel a run."""
    return _make_reading(f"{_key('runs', run_id)}/cancel", Done, run_id)


def cancel_request(request_id: str) -> Question[Done]:
    """Cancel a kinematics request."""
    key = f"{_key('requests', request_id)}/cancel"
    return Question(key, _make_reader(key, Done), request_id=request_id)


def recording(run_id: str) -> Question[bytes]:
    """Read the recording of one run."""
    return Question(f"{_key('runs', run_id)}/recording", bytes, run_id=run_id)


def proof(run_id: str) -> Question[bytes]:
    """Read the proof of one run."""
    return Question(f"{_key('runs', run_id)}/proof", bytes, run_id=run_id)


def share(kind: Literal["runs", "scenes", "robots"], name: str) -> Question[Done]:
    """Share a thing with all users."""
    return _make_reading(f"{_key(kind, name)}?share", Done, name if kind == "runs" else None)


def unshare(kind: Literal["runs", "scenes", "robots"], name: str) -> Question[Done]:
    """End the sharing of a thing."""
    return _make_reading(f"{_key(kind, name)}?unshare", Done, name if kind == "runs" else None)


def stream_open(request: StreamOpen | dict[str, Any] | None, fields: dict[str, Any]) -> StreamOpen:
    """Read the request that opens a stream, or its fields.

    Raises MalformedRequest if that doesn't open a stream, or both are given.
    """
    given = _take_either("stream", request, fields)
    if isinstance(given, dict):
        given = cast(StreamOpen, codec.convert(codec.plain_fields(given), StreamOpen))
    return given


def open_stream(request: StreamOpen) -> Question[StreamReply]:
    """Open a stream under its name."""
    own, needs = request.stream_id, _list_needs(request)
    return Question(
        "streams", _make_reader("streams", StreamReply), _encode(request), request_id=own, work=True, needs=needs
    )


def streams() -> Question[StreamsReply]:
    """List the open streams."""
    return _make_reading("streams", StreamsReply)


def _about_stream(
    stream_id: str, part: str, kind: type[_M], message: msgspec.Struct | None = None, *, repeatable: bool = True
) -> Question[_M]:
    key = f"{_key('streams', stream_id)}{part}"
    payload = None if message is None else _encode(message)
    return Question(key, _make_reader(key, kind), payload, request_id=stream_id, repeatable=repeatable)


def read_stream(stream_id: str) -> Question[StreamReply]:
    """Read the state of one stream."""
    return _about_stream(stream_id, "", StreamReply)


def end_stream(stream_id: str) -> Question[Done]:
    """End a stream."""
    return _about_stream(stream_id, "?delete", Done, repeatable=False)


def aim_stream(
    stream_id: str, goal: StreamGoal | dict[str, Any] | None
) -> tuple[Question[StreamAimed], StreamGoal | None]:
    """Give a stream another goal; return the question and the goal; raises MalformedRequest if that is no goal."""
    aim: StreamAim = codec.convert(codec.plain_fields({"goal": goal}), StreamAim)
    return _about_stream(stream_id, "/goal", StreamAimed, aim), aim.goal


def judge_stream(stream_id: str, time: float) -> Question[StreamJudged]:
    """Ask whether a stream's last piece is still proven from a time on [s].

    Raises MalformedRequest if that is no time.
    """
    judge: StreamJudge = codec.convert({"time": time}, StreamJudge)
    return _about_stream(stream_id, "/judge", StreamJudged, judge)


def stop_stream(stream_id: str) -> Question[Done]:
    """Stop the robot of a stream."""
    return _about_stream(stream_id, "/stop", Done)


def stream_recording(stream_id: str) -> Question[bytes]:
    """Read the recording of one stream."""
    return Question(f"{_key('streams', stream_id)}/recording", bytes, request_id=stream_id)


def info() -> Question[InfoReply]:
    """Read the facts about the service."""
    return _make_reading("info", InfoReply)


def refusal(payload: bytes) -> GuidefieldError | None:
    """Return the exception that an error on the wire names; None if the error isn't one of ours."""
    try:
        error = msgspec.msgpack.decode(payload, type=ErrorReply)
    except msgspec.DecodeError:
        return None
    return make_error(error)


def _run(key: str, request: MotionRequest, allowed: float, kind: type[_M]) -> Question[_M]:
    run_id = request.run_id or uuid.uuid4().hex
    sent, timeout = _encode(msgspec.structs.replace(request, run_id=run_id)), allowed + PLAN_MARGIN
    return Question(key, _make_reader(key, kind), sent, timeout, run_id, work=True, needs=_list_needs(request))


def _take_either(what: str, request: _Q | dict[str, Any] | None, fields: dict[str, Any]) -> _Q | dict[str, Any]:
    if request is not None and fields:
        raise MalformedRequest(
            f"give a {what} request or its fields, not both; beside a request came {', '.join(fields)}"
        )
    return fields if request is None else request


def _key(room: str, name: str) -> str:
    return f"{room}/{_word(name)}"


def _word(value: object) -> str:
    word = str(value)
    if not _WORD.fullmatch(word):
        raise MalformedRequest(f"a name that is asked for has none of / ? # * $ ; and isn't empty, got {word[:64]!r}")
    return word


def _make_reading(key: str, kind: type[_M], run_id: str | None = None) -> Question[_M]:
    return Question(key, _make_reader(key, kind), run_id=run_id)


def _make_deleting(key: str, run_id: str | None = None) -> Question[Done]:
    return Question(f"{key}?delete", _make_reader(key, Done), run_id=run_id, repeatable=False, forgets=key)


def _list_needs(request: MotionRequest | KinematicsRequest | StreamOpen) -> tuple[str, ...]:
    robot, scene = getattr(request, "robot", None), getattr(request, "scene", None)
    named = {"robots": robot, "scenes": scene.base if isinstance(scene, RequestScene) else scene}
    return tuple(f"{room}/{name}" for room, name in named.items() if isinstance(name, str))


def _make_reader(key: str, kind: type[_M]) -> Callable[[bytes], _M]:
    def read(payload: bytes) -> _M:
        try:
            return msgspec.msgpack.decode(payload, type=kind)
        except msgspec.DecodeError as error:
            raise InternalFailure(f"the answer at {key!r} is no {kind.__name__}: {error}", key=key) from error

    return read


def _encode(message: msgspec.Struct) -> bytes:
    payload = codec.encode(message, Encoding.MSGPACK)
    if len(payload) > codec.MAX_REQUEST_BYTES:
        raise RequestTooLarge(
            f"the request has {len(payload)} bytes, at most {codec.MAX_REQUEST_BYTES} are read",
            bytes=len(payload),
            limit=codec.MAX_REQUEST_BYTES,
        )
    return payload
