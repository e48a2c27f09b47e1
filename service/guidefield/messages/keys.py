"""Keys to requests: what a query below an instance's key asks for."""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from operator import index
from typing import Any, SupportsIndex

import msgspec

from guidefield.errors import MalformedRequest
from guidefield.messages import codec, request_reader, requests
from guidefield.messages.codec import Encoding
from guidefield.messages.identities import PLAIN, Asker
from guidefield.messages.kinematics_requests import DEFAULT_TIME
from guidefield.messages.scene import Scene
from guidefield.messages.scene_changes import SceneDiff
from guidefield.messages.served import SERVED, SHARING
from guidefield.messages.values import LONGEST_TIME, PLANNING_TIME, RunId

LONGEST_STORING = 120.0
"""How long a robot or scene may take that is stored or described, the list of robots, a stream's recording [s]."""


MIN_BESIDE = 1 << 16
"""Smallest payload that travels to a worker beside the pickled query [bytes]."""


@dataclass(frozen=True)
class Query:
    """A query as it came.

    Attributes:
        key: Chunks of its key below the instance's or the user's, such as ("scenes", "shelf").
        parameters: Those after the question mark.
        payload: Empty where there is none.
        encoding: How the payload is written, and the reply is to be.
        user: Whose keys it uses.
        owner: Whose things it is about.
        client: Which client of this user asks, as far as it says so.
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
        """Leave a large payload out of what is pickled, where whoever pickles takes it along beside that."""
        if index(protocol) < 5 or len(self.payload) < MIN_BESIDE:
            return super().__reduce_ex__(protocol)
        rest = {name: value for name, value in vars(self).items() if name != "payload"}
        return _with_payload, (rest, pickle.PickleBuffer(self.payload))

    @property
    def asker(self) -> Asker:
        """Who asks."""
        return Asker(self.user, self.client)


def _with_payload(rest: dict[str, Any], payload: bytes | bytearray) -> Query:
    return Query(payload=bytes(payload), **rest)


def _allowed(asked: float, default: float) -> float:
    """A time [s] within what a valid request can ask for; who asks for none at all is refused when it is read."""
    return min(asked, LONGEST_TIME) if asked > 0.0 else default


class PlanHead(msgspec.Struct, frozen=True):
    """The fields of a plan request about the run itself, read without looking at the rest."""

    run_id: RunId | None = None
    allowed_planning_time: float = PLANNING_TIME
    planner: str = "auto"
    objective: str = "balanced"
    seed: int = 0

    @property
    def allowed(self) -> float:
        """The allowed planning time, brought within what a valid request can ask for [s]."""
        return _allowed(self.allowed_planning_time, PLANNING_TIME)


class CertifyHead(msgspec.Struct, frozen=True):
    """The fields of a certify request about the run itself, read without looking at the rest."""

    run_id: RunId | None = None
    allowed_time: float = PLANNING_TIME

    @property
    def allowed(self) -> float:
        """The allowed time, brought within what a valid request can ask for [s]."""
        return _allowed(self.allowed_time, PLANNING_TIME)


class _Head(msgspec.Struct):
    """The type of a payload, if it has one."""

    type: str | None = None


RunHead = PlanHead | CertifyHead


class WorkHead(msgspec.Struct, frozen=True):
    """The name and allowed time of a request that makes no run, read without looking at the rest."""

    request_id: str | None = None
    allowed_time: float = DEFAULT_TIME

    @property
    def allowed(self) -> float:
        """The allowed time, brought within what a valid request can ask for [s]."""
        return _allowed(self.allowed_time, DEFAULT_TIME)


def check(query: Query) -> None:
    """Check all of a query but its payload.

    Raises:
        MalformedRequest: if the key is not served, or the query has parameters or a payload that don't fit it.
    """
    if is_file(query) or is_cancel(query):
        _refuse_payload(query)
    else:
        _rule(query)


def request_of(query: Query) -> requests.Request:
    """The request that a query makes.

    Raises:
        MalformedRequest: if the key is not served, or its parameters or payload don't fit it.
        RequestTooLarge: if the payload is too long to be looked at.
    """
    return _rule(query).read(query)


def run_head(query: Query) -> RunHead | None:
    """The head of a request that makes a run, a plan or a judgement; None if the query asks for something else.

    Raises:
        MalformedRequest, RequestTooLarge: as `request_of`, for what was looked at.
    """
    kind = _HEADS.get(query.key)
    if kind is None:
        return None
    head: RunHead = codec.decode(query.payload, kind, query.encoding)
    return head


def work_head(query: Query) -> WorkHead:
    """The head of a kinematics request; of anything else that takes work, how long that may take.

    Raises:
        MalformedRequest, RequestTooLarge: as `request_of`, for what was looked at.
    """
    if query.key != ("kinematics",):
        return WorkHead(allowed_time=LONGEST_STORING)
    head: WorkHead = codec.decode(query.payload, WorkHead, query.encoding)
    return head


def changes_store(query: Query) -> bool:
    """Return whether the query stores or deletes something: once begun it comes to its end, whoever waits for it."""
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


def diff_of(query: Query) -> SceneDiff | None:
    """Return the changes that an answered query made to a scene; None if it stored the scene anew."""
    if codec.decode(query.payload, _Head, query.encoding).type is None:
        return None
    diff: SceneDiff = codec.decode(query.payload, SceneDiff, query.encoding)
    return diff


def is_sharing(query: Query) -> bool:
    """Return whether the query is to share something with everybody, or with nobody any more."""
    return bool(query.parameters.keys() & SHARING)


def is_reading(query: Query) -> bool:
    """Return whether the query changes nothing."""
    return not (query.payload or is_cancel(query) or is_sharing(query) or "delete" in query.parameters)


def is_brief(query: Query) -> bool:
    """Return whether the query asks for info, and for its figures only."""
    return "brief" in query.parameters


def is_list(query: Query) -> bool:
    """Return whether the query asks for all that there is of a kind, or for all of info."""
    return query.key in (("robots",), ("scenes",), ("runs",)) or (query.key == ("info",) and not is_brief(query))


def _plan(query: Query) -> requests.Request:
    request: requests.Request = request_reader.read_payload(query.payload, requests.PlanRequest, query.encoding)
    return request


def _certify(query: Query) -> requests.Request:
    request: requests.Request = request_reader.read_payload(query.payload, requests.CertifyRequest, query.encoding)
    return request


def _kinematics(query: Query) -> requests.Request:
    request: requests.Request = request_reader.read_payload(query.payload, requests.KinematicsRequest, query.encoding)
    return request


def _robot(query: Query) -> requests.Request:
    name = query.key[1]
    if "delete" in query.parameters:
        _refuse_payload(query)
        return requests.DeleteRobot(name)
    if not query.payload:
        return requests.ReadRobot(name)
    return requests.StoreRobot(name, codec.decode(query.payload, requests.RobotFiles, query.encoding))


def _scene(query: Query) -> requests.Request:
    name = query.key[1]
    if "delete" in query.parameters:
        _refuse_payload(query)
        return requests.DeleteScene(name)
    version = _version(query.parameters.get("version"))
    if not query.payload:
        return requests.ReadScene(name, version)
    if version is not None:
        raise MalformedRequest("`version` is for reading; a change says itself which it means", parameter="version")
    if codec.decode(query.payload, _Head, query.encoding).type is not None:
        return requests.ChangeScene(name, codec.decode(query.payload, SceneDiff, query.encoding))
    scene: Scene = codec.decode(query.payload, Scene, query.encoding)
    if scene.name != name:
        raise MalformedRequest(
            f"the scene is named {scene.name!r}, but it is sent to be stored as {name!r}", path="$.name"
        )
    return requests.StoreScene(name, scene)


def _version(text: str | None) -> int | None:
    """The version of a scene that a parameter names, if any."""
    if text is None:
        return None
    if not (text.isascii() and text.isdigit() and 0 < int(text) < 2**63):
        raise MalformedRequest(f"`version` must be a number from 1 on, got {text[:64]!r}", parameter="version")
    return int(text)


def _runs(query: Query) -> requests.Request:
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


def _run(query: Query) -> requests.Request:
    kind = requests.DeleteRun if "delete" in query.parameters else requests.ReadRun
    return kind(query.key[1])


@dataclass(frozen=True)
class _Rule:
    """The rule of one key: the reader of its queries, and the parameters that they may have."""

    read: Callable[[Query], requests.Request]
    parameters: frozenset[str] = frozenset()
    takes_payload: bool = False


_RULES = {
    ("plan", 1): _Rule(_plan, takes_payload=True),
    ("certify", 1): _Rule(_certify, takes_payload=True),
    ("kinematics", 1): _Rule(_kinematics, takes_payload=True),
    ("robots", 1): _Rule(lambda _: requests.ReadRobots()),
    ("robots", 2): _Rule(_robot, frozenset({"delete", *SHARING}), takes_payload=True),
    ("scenes", 1): _Rule(lambda _: requests.ReadScenes()),
    ("scenes", 2): _Rule(_scene, frozenset({"delete", "version", *SHARING}), takes_payload=True),
    ("runs", 1): _Rule(_runs, frozenset(requests.ReadRuns.__struct_fields__)),
    ("runs", 2): _Rule(_run, frozenset({"delete", *SHARING})),
    ("info", 1): _Rule(lambda _: requests.ReadInfo(), frozenset({"brief"})),
}
"""Rules by the first chunk of the key and the number of chunks."""

_HEADS: dict[tuple[str, ...], type[RunHead]] = {("plan",): PlanHead, ("certify",): CertifyHead}
"""Keys of requests that make a run, and what is read of them at once."""


def _rule(query: Query) -> _Rule:
    rule = _RULES.get((query.key[0] if query.key else "", len(query.key)))
    if rule is None:
        raise MalformedRequest(
            f"nothing is served at {'/'.join(query.key)!r}; served are {', '.join(SERVED)}",
            key="/".join(query.key),
            served=list(SERVED),
        )
    unknown = sorted(set(query.parameters) - rule.parameters)
    if unknown:
        valid = ", ".join(sorted(rule.parameters)) or "none"
        raise MalformedRequest(
            f"unknown parameter {unknown[0]!r} at {'/'.join(query.key)!r}; valid: {valid}", parameter=unknown[0]
        )
    if not rule.takes_payload or is_sharing(query):
        _refuse_payload(query)
    return rule


def _refuse_payload(query: Query) -> None:
    if query.payload:
        raise MalformedRequest(
            f"a query on {'/'.join(query.key)!r} of this kind takes no payload", key="/".join(query.key)
        )
