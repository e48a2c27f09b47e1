"""The keys of a service: what each is for, takes and gives, and how the request of a query on it is decoded.

A new key is a row in `KEYS`; if its queries have requests, also a line in `_READERS`, which reads all keys with its
first chunk and as many chunks, but for those of streams (stream_requests.py). `KEYS` are in `info` and docs/wire.md:
after a change, `tools/wire_page`. Heads repeat fields of requests, with defaults, so that a run can be queued before
all of its request is decoded.
"""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable, Collection, Mapping
from operator import index
from typing import Any, NamedTuple, SupportsIndex

import msgspec

from guidefield.errors import MalformedRequest
from guidefield.messages import codec, requests
from guidefield.messages.codec import Encoding
from guidefield.messages.identities import PLAIN, Asker
from guidefield.messages.kinematics import DEFAULT_TIME, KinematicsReply, KinematicsRequest
from guidefield.messages.scene import Scene
from guidefield.messages.scene_changes import SceneDiff
from guidefield.messages.service import KeyInfo
from guidefield.messages.values import LONGEST_TIME, PLANNING_TIME, RunId

STORE_TIME_LIMIT = 120.0
"""Allowed time to store or describe a robot or scene, to list robots, or to make a stream's recording [s].

docs/wire.md tells it: after a change, `tools/wire_page`. `PREPARE_WITHIN` of `handlers/robots.py` stays below,
`ANSWER_TIMEOUT` of `client/questions.py` above.
"""

SHARING = {
    "share": "lets every user read it, as `<user>:<name>`",
    "unshare": "ends that, but for operators",
}
"""The parameters that share."""
DELETE = {"delete": "forgets it"}

MIN_BESIDE = 1 << 16
"""Smallest payload that is sent to a worker out of band, beside the pickled query, instead of copied [bytes]."""


class Query(msgspec.Struct, frozen=True, array_like=True):
    """A query before its payload is decoded.

    Attributes:
        key: Chunks of its key below the instance's or the user's, such as ("scenes", "shelf").
        parameters: Those after the question mark.
        payload: Empty if there is none.
        encoding: The encoding of the payload and of the reply.
        user: The user whose keys it uses.
        owner: The user whose things it is about.
        client: The client of this user that asks; empty if it gives no name.
        names_owner: Whether its key has the owner before the thing's name.
    """

    key: tuple[str, ...]
    parameters: Mapping[str, str]
    payload: bytes
    encoding: Encoding
    user: str = PLAIN
    owner: str = PLAIN
    client: str = ""
    names_owner: bool = False

    def __reduce_ex__(self, protocol: SupportsIndex) -> Any:
        """Pickle a large payload out of band (protocol 5)."""
        is_beside = index(protocol) >= 5 and len(self.payload) >= MIN_BESIDE
        head = _ENCODER.encode(msgspec.structs.replace(self, payload=b""))
        return _restore_query, (head, pickle.PickleBuffer(self.payload) if is_beside else self.payload)

    @property
    def asker(self) -> Asker:
        """The user and client that ask."""
        return Asker(self.user, self.client)


_ENCODER, _DECODER = msgspec.msgpack.Encoder(), msgspec.msgpack.Decoder(Query)


def _restore_query(head: bytes, payload: bytes | bytearray) -> Query:
    query: Query = _DECODER.decode(head)
    return msgspec.structs.replace(query, payload=bytes(payload))


def _limit_time(asked: float, default: float) -> float:
    """Limit a time [s] to that of a valid request; the decoder later refuses a request with a time of 0 or less."""
    return min(asked, LONGEST_TIME) if asked > 0.0 else default


class PlanHead(msgspec.Struct, frozen=True):
    """The fields of a plan request about the run itself, decoded without the others."""

    run_id: RunId | None = None
    allowed_planning_time: float = PLANNING_TIME
    planner: str = "auto"
    objective: str = "balanced"
    seed: int = 0

    @property
    def allowed(self) -> float:
        """The allowed planning time, limited to that of a valid request [s]."""
        return _limit_time(self.allowed_planning_time, PLANNING_TIME)


class CertifyHead(msgspec.Struct, frozen=True):
    """The fields of a certify request about the run itself, decoded without the others."""

    run_id: RunId | None = None
    allowed_time: float = PLANNING_TIME

    @property
    def allowed(self) -> float:
        """The allowed time, limited as `PlanHead.allowed` [s]."""
        return _limit_time(self.allowed_time, PLANNING_TIME)


RunHead = PlanHead | CertifyHead


class WorkHead(msgspec.Struct, frozen=True):
    """The name and allowed time of a request that makes no run, decoded without the other fields."""

    request_id: str | None = None
    allowed_time: float = DEFAULT_TIME

    @property
    def allowed(self) -> float:
        """The allowed time, limited as `PlanHead.allowed` [s]."""
        return _limit_time(self.allowed_time, DEFAULT_TIME)


def check(query: Query) -> None:
    """Check all of a query but its payload; raises MalformedRequest if its key isn't served, or one doesn't fit it."""
    if is_file(query) or is_cancel(query):
        require_no_payload(query)
    else:
        _find_rule(query)


def decode_query(query: Query) -> requests.Request:
    """Decode the request of a query.

    Raises:
        MalformedRequest: if the key is not served, or its parameters or payload don't fit it.
        RequestTooLarge: if the payload is too long to be decoded.
    """
    return _find_rule(query).read(query)


def decode_run_head(query: Query) -> RunHead | None:
    """Decode the head of a plan or certify request, as `decode_query`; None for any other query."""
    kind = _HEADS.get(query.key)
    if kind is None:
        return None
    head: RunHead = codec.decode(query.payload, kind, query.encoding)
    return head


def decode_work_head(query: Query) -> WorkHead:
    """Decode the head of a kinematics request; any other query gets a head with the longest time."""
    if query.key != ("kinematics",):
        return WorkHead(allowed_time=STORE_TIME_LIMIT)
    head: WorkHead = codec.decode(query.payload, WorkHead, query.encoding)
    return head


def changes_store(query: Query) -> bool:
    """Return whether the query stores or deletes something: once begun it is finished, even without its caller."""
    return query.key[0] in ("robots", "scenes", "runs") and (bool(query.payload) or "delete" in query.parameters)


def is_recording(query: Query) -> bool:
    """Return whether the query asks for a recording."""
    return len(query.key) == 3 and query.key[0] in ("runs", "streams") and query.key[2] == "recording"


def is_proof(query: Query) -> bool:
    """Return whether the query asks for the proof of a run."""
    return len(query.key) == 3 and query.key[::2] == ("runs", "proof")


def is_file(query: Query) -> bool:
    """Return whether the query asks for a recording or a proof: the answers that aren't messages."""
    return is_recording(query) or is_proof(query)


def is_cancel(query: Query) -> bool:
    """Return whether the query asks for the early end of a run or request."""
    return len(query.key) == 3 and query.key[0] in ("runs", "requests") and query.key[2] == "cancel"


def is_scene(query: Query) -> bool:
    """Return whether the query is about one scene."""
    return len(query.key) == 2 and query.key[0] == "scenes"


def decode_diff(query: Query) -> SceneDiff | None:
    """Decode the changes that an answered query made to a scene; None if it stored a whole scene."""
    if codec.decode(query.payload, codec.TypeTag, query.encoding).type is None:
        return None
    diff: SceneDiff = codec.decode(query.payload, SceneDiff, query.encoding)
    return diff


def is_sharing(query: Query) -> bool:
    """Return whether the query shares something with all users, or ends that."""
    return bool(query.parameters.keys() & SHARING)


def is_reading(query: Query) -> bool:
    """Return whether the query changes nothing."""
    return not (query.payload or is_cancel(query) or is_sharing(query) or "delete" in query.parameters)


def is_brief(query: Query) -> bool:
    """Return whether the query asks only for the figures of info."""
    return "brief" in query.parameters


def is_list(query: Query) -> bool:
    """Return whether the query asks for a list of robots, scenes or runs, or for all of info."""
    return query.key in (("robots",), ("scenes",), ("runs",)) or (query.key == ("info",) and not is_brief(query))


def _decode_as(kind: Any) -> Callable[[Query], requests.Request]:
    def read(query: Query) -> requests.Request:
        request: requests.Request = codec.read_payload(query.payload, kind, query.encoding)
        return request

    return read


def _decode_robot(query: Query) -> requests.Request:
    name = query.key[1]
    if "delete" in query.parameters:
        require_no_payload(query)
        return requests.DeleteRobot(name)
    if not query.payload:
        return requests.ReadRobot(name)
    return requests.StoreRobot(name, codec.decode(query.payload, requests.RobotFiles, query.encoding))


def _decode_scene(query: Query) -> requests.Request:
    name = query.key[1]
    if "delete" in query.parameters:
        require_no_payload(query)
        return requests.DeleteScene(name)
    version = _parse_version(query.parameters.get("version"))
    if not query.payload:
        return requests.ReadScene(name, version)
    if version is not None:
        raise MalformedRequest("`version` is for reading; a change says itself which it means", parameter="version")
    if codec.decode(query.payload, codec.TypeTag, query.encoding).type is not None:
        return requests.ChangeScene(name, codec.decode(query.payload, SceneDiff, query.encoding))
    scene: Scene = codec.decode(query.payload, Scene, query.encoding)
    if scene.name != name:
        raise MalformedRequest(
            f"the scene is named {scene.name!r}, but it is sent to be stored as {name!r}", path="$.name"
        )
    return requests.StoreScene(name, scene)


def _parse_version(text: str | None) -> int | None:
    if text is None:
        return None
    if not (text.isascii() and text.isdigit() and 0 < int(text) < 2**63):
        raise MalformedRequest(f"`version` must be a number from 1 on, got {text[:64]!r}", parameter="version")
    return int(text)


def _decode_runs(query: Query) -> requests.Request:
    since = query.parameters.get("since")
    try:
        began_after = None if since is None else float(since)
        if began_after is not None and not math.isfinite(began_after):
            raise ValueError
    except ValueError:
        raise MalformedRequest(f"`since` must be seconds since 1970, got {since!r}", parameter="since") from None
    given = {name: value for name, value in query.parameters.items() if name != "since"}
    try:
        return msgspec.convert({**given, "since": began_after}, requests.ReadRuns, strict=False)
    except msgspec.ValidationError as error:
        fault, _, place = str(error).partition(" - at `$.")
        if place:
            fault = f"`{place} must be {fault.removeprefix('Expected ')}"
        raise MalformedRequest(fault, parameter=fault.split("`")[1]) from None


def _decode_run(query: Query) -> requests.Request:
    kind = requests.DeleteRun if "delete" in query.parameters else requests.ReadRun
    return kind(query.key[1])


KEYS = (
    KeyInfo("plan", "plans a motion", worker="always", takes=["PlanRequest"], gives=["PlanReply"]),
    KeyInfo("certify", "judges a given motion", worker="always", takes=["CertifyRequest"], gives=["CertifyReply"]),
    KeyInfo(
        "kinematics",
        "kinematics, dynamics, distances, potentials",
        worker="always",
        takes=[kind.__name__ for kind in KinematicsRequest.__args__],
        gives=[kind.__name__ for kind in KinematicsReply.__args__],
    ),
    KeyInfo("requests/<id>/cancel", "cancels a kinematics request", gives=["Done"]),
    KeyInfo("robots", "lists robots", worker="always", gives=["RobotsReply"]),
    KeyInfo(
        "robots/<name>",
        "describes a robot; with a payload stores it",
        worker="always",
        parameters=DELETE | SHARING,
        takes=["RobotFiles"],
        gives=["RobotReply", "Done"],
    ),
    KeyInfo("scenes", "lists scenes", gives=["ScenesReply"]),
    KeyInfo(
        "scenes/<name>",
        "reads a scene; with a payload stores or changes it",
        worker="with a payload",
        parameters={**DELETE, **SHARING, "version": "one of the last 16"},
        takes=["Scene", "SceneDiff"],
        gives=["SceneReply", "Done"],
    ),
    KeyInfo("scenes/<name>/changes", "changes of a stored scene", how="published", gives=["SceneChanged"]),
    KeyInfo(
        "runs",
        "lists kept runs, newest first",
        parameters={
            "status": "name of a status, RUNNING or UNREADABLE",
            "robot": "its name",
            "since": "begin [s since 1970]",
            "text": "part of the status's message",
            "limit": "up to 1000",
            "after": "`next` of the page before",
        },
        gives=["RunsReply"],
    ),
    KeyInfo(
        "runs/<id>",
        "request and reply of a run, also while it runs",
        parameters={"delete": "forgets it, its recording and proof", **SHARING},
        gives=["RunReply", "CertifyRunReply", "Done"],
    ),
    KeyInfo("runs/<id>/recording", "a run's recording, .rrd", worker="while it is owed"),
    KeyInfo("runs/<id>/proof", "a run's proof, .npz"),
    KeyInfo("runs/<id>/cancel", "cancels a run", gives=["Done"]),
    KeyInfo("runs/<id>/progress", "progress of a run", how="published", gives=["Progress"]),
    KeyInfo(
        "shared/runs/<user>:<id>/progress",
        "progress of a shared run, for every user",
        how="published",
        gives=["Progress"],
    ),
    KeyInfo(
        "streams",
        "lists open streams; with a payload opens one",
        worker="with a payload",
        takes=["StreamOpen"],
        gives=["StreamsReply", "StreamReply"],
    ),
    KeyInfo(
        "streams/<id>",
        "state of a stream",
        parameters={"delete": "ends it"},
        gives=["StreamReply", "Done"],
    ),
    KeyInfo(
        "streams/<id>/goal",
        "sets its goal",
        worker="with a payload",
        takes=["StreamAim"],
        gives=["StreamAimed"],
    ),
    KeyInfo(
        "streams/<id>/judge",
        "judges its last piece by the last observations",
        worker="with a payload",
        takes=["StreamJudge"],
        gives=["StreamJudged"],
    ),
    KeyInfo("streams/<id>/stop", "stops its robot", gives=["Done"]),
    KeyInfo(
        "streams/<id>/recording",
        "a kept stream, .rrd, made on demand",
        worker="always",
    ),
    KeyInfo("streams/<id>/update", "what its client sees", how="put", takes=["StreamUpdate"]),
    KeyInfo("streams/<id>/pieces", "pieces of motion, each with its stop", how="published", gives=["Piece"]),
    KeyInfo("streams/<id>/state", "why an update got no piece", how="published", gives=["StreamState"]),
    KeyInfo(
        "info",
        "state, figures, rules and schemas of the service",
        parameters={"brief": "state and figures only"},
        gives=["InfoReply"],
    ),
    KeyInfo("alive", "exists while requests are taken", how="token"),
    KeyInfo("clients/<client>", "declared by a client; when it is gone, its requests end", how="token"),
    KeyInfo("starting", "exists while the service starts", how="token"),
    KeyInfo("starting/<id>", "exists while a service looks whether another one has its name", how="token"),
)
"""Every key."""

SERVED = tuple(key.key for key in KEYS if key.how == "query")
"""The keys that can be queried, which the error about any other lists."""

_READERS: dict[str, Callable[[Query], requests.Request]] = {
    "plan": _decode_as(requests.PlanRequest),
    "certify": _decode_as(requests.CertifyRequest),
    "kinematics": _decode_as(requests.KinematicsRequest),
    "robots": lambda _: requests.ReadRobots(),
    "robots/<name>": _decode_robot,
    "scenes": lambda _: requests.ReadScenes(),
    "scenes/<name>": _decode_scene,
    "runs": _decode_runs,
    "runs/<id>": _decode_run,
    "info": lambda _: requests.ReadInfo(),
}
"""Decoders of requests by key; the other keys have no request, or are those of stream_requests.py."""


class _Rule(NamedTuple):
    read: Callable[[Query], requests.Request]
    parameters: Collection[str]
    takes_payload: bool


_RULES = {
    (key.key.partition("/")[0], key.key.count("/") + 1): _Rule(_READERS[key.key], key.parameters, bool(key.takes))
    for key in KEYS
    if key.key in _READERS
}
"""Rules by the first chunk of the key and the number of chunks."""

_HEADS: dict[tuple[str, ...], type[RunHead]] = {("plan",): PlanHead, ("certify",): CertifyHead}
"""Heads of the requests that make a run, by key; `endpoint/endpoint.py` files the run of any but certify as a plan."""


def _find_rule(query: Query) -> _Rule:
    rule = _RULES.get((query.key[0] if query.key else "", len(query.key)))
    if rule is None:
        raise refuse_key(query)
    require_parameters(query, rule.parameters)
    if not rule.takes_payload or is_sharing(query):
        require_no_payload(query)
    return rule


def refuse_key(query: Query) -> MalformedRequest:
    """Make the error of a key at which nothing is served."""
    key = "/".join(query.key)
    return MalformedRequest(
        f"nothing is served at {key!r}; served are {', '.join(SERVED)}", key=key, served=list(SERVED)
    )


def require_parameters(query: Query, valid: Collection[str]) -> None:
    """Raise MalformedRequest if a query has a parameter that isn't valid."""
    if query.parameters and (unknown := sorted(query.parameters.keys() - {*valid})):
        told = f"unknown parameter {unknown[0]!r} at {'/'.join(query.key)!r}"
        raise MalformedRequest(f"{told}; valid: {', '.join(sorted(valid)) or 'none'}", parameter=unknown[0])


def require_no_payload(query: Query) -> None:
    """Raise MalformedRequest if a query has a payload."""
    if query.payload:
        key = "/".join(query.key)
        raise MalformedRequest(f"a query on {key!r} of this kind takes no payload", key=key)
