"""ROS 2's wire on Zenoh, as rmw_zenoh has it: messages as bytes, hashes of types, keys, tokens and attachments.

Messages are encoded as CDR, and types hashed as RIHS01, by the library rosbags. A message is an object with the fields
of its type: numbers, texts, other messages, lists of them, and NumPy arrays where a field has many numbers. Types are
named as ROS does: ``std_msgs/msg/String``, ``moveit_msgs/srv/GetMotionPlan_Request``. Fields, their order and names of
types must be those of the distribution: a type with another hash is another type for its nodes.

Names follow the design document of rmw_zenoh, which has to be kept to the letter: a service or topic has the key
``<domain>/<name>/<type>/<hash>``, and each node, publisher, subscription and service declares a liveliness token below
``@ros2_lv``, of which ROS makes its graph. In tokens a slash of a name is a percent sign.
"""

from __future__ import annotations

import enum
import functools
import struct
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from importlib import resources
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from guidefield.endpoint.link import Distribution

MOST_BYTES = 8 * 2**20  # largest payload that is read; its objects take tens of times as much memory
MOST_ENTRIES = 2_000_000  # number of entries of the largest sequence that is read

_NUMBERS = {
    "bool": np.bool_, "byte": np.uint8, "int8": np.int8, "uint8": np.uint8, "int16": np.int16, "uint16": np.uint16,
    "int32": np.int32, "uint32": np.uint32, "int64": np.int64, "uint64": np.uint64, "float32": np.float32,
    "float64": np.float64,
}  # fmt: skip
PACKAGES = (
    "builtin_interfaces",
    "std_msgs",
    "geometry_msgs",
    "sensor_msgs",
    "trajectory_msgs",
    "shape_msgs",
    "unique_identifier_msgs",
    "action_msgs",
)
"""Packages whose messages are taken from rosbags; all others stand in `moveit.msg`."""
_DEFAULTS = {("geometry_msgs/msg/Quaternion", "w"): 1.0}  # default values of fields other than zero


class Unreadable(ValueError):
    """A payload is no message of its type; says why."""


class Types:
    """The types of a distribution; reads and writes their messages.

    Args:
        known: Rosbags' types of it, of which `PACKAGES` are taken.
        messages: Fields of each other message, by its package and name.
        services: Fields of each service's request and response.
        actions: Fields of each action's goal, result and feedback.
    """

    def __init__(
        self,
        known: Stores,
        messages: Mapping[str, str],
        services: Mapping[str, tuple[str, str]],
        actions: Mapping[str, tuple[str, str, str]] | None = None,
    ) -> None:
        self._store = get_typestore(Stores.EMPTY)
        self._store.max_sequence_length = MOST_ENTRIES
        theirs = get_typestore(known).fielddefs
        definitions = {name: fields for name, fields in theirs.items() if name.partition("/")[0] in PACKAGES}
        for name, fields in messages.items():
            definitions |= _parse(name.replace("/", "/msg/"), fields)
        for name, (request, response) in services.items():
            own = name.replace("/", "/srv/")
            definitions |= _service(own, _parse(f"{own}_Request", request), _parse(f"{own}_Response", response))
        for name, (goal, result, feedback) in (actions or {}).items():
            definitions |= _action(name.replace("/", "/action/"), goal, result, feedback)
        self._store.register(definitions)
        self._made: dict[str, dict[str, _Field]] = {}

    @property
    def names(self) -> list[str]:
        """Return the names of all types, with those of services' parts."""
        return list(self._store.fielddefs)

    def fields(self, name: str) -> list[tuple[str, Any]]:
        """Return the fields of a type in order, each with rosbags' description of its type."""
        return list(self._store.fielddefs[name][1])

    def type_hash(self, name: str) -> str:
        """Return the hash by which nodes distinguish versions of a type, ``RIHS01_`` and 64 digits."""
        return self._store.hash_rihs01(name)

    def new(self, name: str, /, **given: Any) -> Any:
        """Make a message with some of its fields; all others are zero, empty or false, and a quaternion the identity.

        A message within it may be given as a dict of its fields.
        """
        fields = self._fields_of(name)
        if unknown := given.keys() - fields.keys():
            raise TypeError(f"{name} has no field {', '.join(sorted(unknown))}")
        values = [one.fitting(given[field]) if field in given else one.blank() for field, one in fields.items()]
        return self._store.types[name](*values)

    def read(self, payload: bytes, name: str) -> Any:
        """Read a message from a payload; raises Unreadable if it is none of that type, or larger than `MOST_BYTES`."""
        if len(payload) > MOST_BYTES:
            raise Unreadable(f"the payload has {len(payload)} bytes, at most {MOST_BYTES} are read")
        try:
            return self._store.deserialize_cdr(payload, name)
        except Exception as error:  # whatever a library raises at bytes that anybody may send
            raise Unreadable(f"the payload is no {name}: {error}") from None

    def write(self, message: Any, name: str) -> bytes:
        """Return the bytes of a message, with their header, little-endian."""
        return bytes(self._store.serialize_cdr(message, name, little_endian=True))

    def _fields_of(self, name: str) -> dict[str, _Field]:
        if name not in self._made:
            self._made[name] = {field: self._field(name, field, kind) for field, kind in self.fields(name)}
        return self._made[name]

    def _field(self, name: str, field: str, kind: Any) -> _Field:
        node, inner = kind
        if node == Nodetype.NAME:
            return _Field(functools.partial(self.new, inner), functools.partial(self._to_message, inner))
        if node == Nodetype.BASE:
            zero = "" if inner[0] == "string" else _NUMBERS[inner[0]]().item()
            value = _DEFAULTS.get((name, field), zero)
            return _Field(lambda: value, _identity)
        element, count = inner
        if element[0] == Nodetype.BASE and element[1][0] != "string":
            numbers = _NUMBERS[element[1][0]]
            most = count if node == Nodetype.ARRAY else 0
            return _Field(lambda: np.zeros(most, numbers), lambda value: np.asarray(value, numbers))
        if element[0] == Nodetype.NAME:
            return _Field(list, lambda values: [self._to_message(element[1], value) for value in values])
        return _Field(list, _identity)

    def _to_message(self, name: str, value: Any) -> Any:
        return self.new(name, **value) if isinstance(value, dict) else value


@dataclass(frozen=True)
class _Field:
    """A field of a message."""

    blank: Callable[[], Any]  # makes its default value
    fitting: Callable[[Any], Any]  # converts a given value to its type


def _identity(value: Any) -> Any:
    return value


def _parse(name: str, fields: str) -> dict[str, Any]:
    package, _, own = name.split("/")
    (definition,) = get_types_from_msg(fields, f"{package}/msg/{own}").values()
    return {name: definition}


def _action(name: str, goal: str, result: str, feedback: str) -> dict[str, Any]:
    def one(of: str) -> tuple[Nodetype, str]:
        return Nodetype.NAME, of

    def with_id(of: str, *others: tuple[str, Any]) -> dict[str, Any]:
        return {of: ([], [("goal_id", one("unique_identifier_msgs/msg/UUID")), *others])}

    got = [("status", (Nodetype.BASE, ("int8", 0))), ("result", one(f"{name}_Result"))]
    send, get = f"{name}_SendGoal", f"{name}_GetResult"
    return {
        **_parse(f"{name}_Goal", goal),
        **_parse(f"{name}_Result", result),
        **_parse(f"{name}_Feedback", feedback),
        **_service(
            send,
            with_id(f"{send}_Request", ("goal", one(f"{name}_Goal"))),
            _parse(f"{send}_Response", "bool accepted\nbuiltin_interfaces/Time stamp"),
        ),
        **_service(get, with_id(f"{get}_Request"), {f"{get}_Response": ([], got)}),
        **with_id(f"{name}_FeedbackMessage", ("feedback", one(f"{name}_Feedback"))),
    }


def _service(name: str, request: dict[str, Any], response: dict[str, Any]) -> dict[str, Any]:
    def one(of: str) -> tuple[Nodetype, str]:
        return Nodetype.NAME, of

    def at_most_one(of: str) -> tuple[Nodetype, Any]:
        return Nodetype.SEQUENCE, (one(of), 1)

    request_type, response_type, event_type = f"{name}_Request", f"{name}_Response", f"{name}_Event"
    return {
        **request,
        **response,
        event_type: (
            [],
            [
                ("info", one("service_msgs/msg/ServiceEventInfo")),
                ("request", at_most_one(request_type)),
                ("response", at_most_one(response_type)),
            ],
        ),
        name: (
            [],
            [
                ("request_message", one(request_type)),
                ("response_message", one(response_type)),
                ("event_message", one(event_type)),
            ],
        ),
    }


def _read_definitions() -> tuple[dict[str, str], dict[str, tuple[str, str]]]:
    messages, services = {}, {}
    text = resources.files(__package__ or "").joinpath("moveit.msg").read_text()
    for title, _, fields in (block.partition("\n") for block in text.strip().split("\n\n# ")[1:]):
        if "/srv/" in title:
            request, _, response = fields.partition("\n---\n")
            services[title.replace("/srv/", "/")] = request, response
        else:
            messages[title.replace("/msg/", "/")] = fields
    return messages, services


MESSAGES, SERVICES = _read_definitions()
"""Definitions, from `moveit.msg`, of messages that rosbags doesn't have, or has otherwise, and of services' messages.

By package and name, each a text with a field per line.
"""


@functools.cache
def types_of(distribution: Distribution) -> Types:
    """Return the types of a distribution."""
    return Types(STORES[distribution], MESSAGES, SERVICES)


STORES = {
    Distribution.JAZZY: Stores.ROS2_JAZZY,
    Distribution.KILTED: Stores.ROS2_KILTED,
    Distribution.LYRICAL: Stores.ROS2_LYRICAL,
    Distribution.ROLLING: Stores.ROS2_LYRICAL,
}
"""Rosbags' types of each distribution; Rolling has those of the newest one."""


GRAPH = "@ros2_lv"  # the first chunk of every token
DEFAULT_QOS = "::,10:,:,:,,"  # reliable, volatile, the last ten: empty entries are rmw_zenoh's defaults
LATCHED_QOS = ":1:,1:,:,:,,"  # reliable, transient local, the last one, which later subscribers get, too


class Kind(enum.StrEnum):
    """What a token represents."""

    NODE = "NN"
    PUBLISHER = "MP"
    SUBSCRIPTION = "MS"
    SERVICE = "SS"
    CLIENT = "SC"


@dataclass(frozen=True)
class Entity:
    """A service, publisher or subscription."""

    kind: Kind
    name: str
    type_name: str
    type_hash: str
    qos: str = DEFAULT_QOS

    @property
    def on_zenoh(self) -> str:
        """Return the name of its type in keys and tokens, such as ``moveit_msgs::srv::dds_::GetMotionPlan_``."""
        package, kind, name = self.type_name.split("/")
        return f"{package}::{kind}::dds_::{name}_"

    def key(self, domain: int) -> str:
        """Return the key of its data in a domain."""
        return f"{domain}/{self.name}/{self.on_zenoh}/{self.type_hash}"


@dataclass(frozen=True)
class Node:
    """A node of a session."""

    domain: int
    session: str
    name: str

    def token(self) -> str:
        """Return the token of the node itself."""
        return f"{self._base(0, Kind.NODE)}/%/%/{self.name}"

    def token_of(self, number: int, entity: Entity) -> str:
        """Return the token of one of its entities, which are numbered from 1."""
        return (
            f"{self._base(number, entity.kind)}/%/%/{self.name}"
            f"/%{entity.name.replace('/', '%')}/{entity.on_zenoh}/{entity.type_hash}/{entity.qos}"
        )

    def _base(self, number: int, kind: Kind) -> str:
        return f"{GRAPH}/{self.domain}/{self.session}/0/{number}/{kind}"


@dataclass(frozen=True)
class RemoteEntity:
    """An entity of another node, as its token describes it."""

    node: str
    kind: str
    name: str
    on_zenoh: str
    type_hash: str

    @classmethod
    def read(cls, token: str) -> RemoteEntity | None:
        """Read a token; None if it is a node's, or none of ROS."""
        chunks = token.split("/")
        if len(chunks) != 13 or chunks[0] != GRAPH:
            return None
        kind, _, space, node, name, on_zenoh, type_hash = chunks[5:12]
        return cls(
            f"{space}/{node}".replace("%", "/").lstrip("/"), kind, name.replace("%", "/")[1:], on_zenoh, type_hash
        )


MOST_NAMED = 100  # number of entities that the log names at most
_COUNTERPARTS = {Kind.SERVICE: Kind.CLIENT, Kind.SUBSCRIPTION: Kind.PUBLISHER, Kind.PUBLISHER: Kind.SUBSCRIPTION}


class MismatchReport:
    """Reports, once each, entities of other nodes with the name of one of ours, but another version of its type."""

    def __init__(self, ours: Iterable[Entity], report: Callable[[str], object]) -> None:
        self._ours = {(_COUNTERPARTS[one.kind].value, one.name): one for one in ours}
        self._report = report
        self._named: set[RemoteEntity] = set()

    def check(self, token: str) -> None:
        """Check a token of another node."""
        seen = RemoteEntity.read(token)
        own = None if seen is None else self._ours.get((seen.kind, seen.name))
        if seen is None or own is None or (seen.on_zenoh, seen.type_hash) == (own.on_zenoh, own.type_hash):
            return
        if seen in self._named or len(self._named) >= MOST_NAMED:
            return
        self._named.add(seen)
        self._report(
            f"node {seen.node[:64]!r} has {seen.name} as {seen.on_zenoh[:64]} of {seen.type_hash[:16]}…, here it is"
            f" {own.on_zenoh} of {own.type_hash[:16]}…: they don't meet; `--ros-distro` must be the node's distribution"
        )


_LAYOUT = struct.Struct("<qqB16s")
"""Sequence number, time since 1970 [ns], length of the identifier, and the identifier."""
_ID_BYTES = 16  # length of a sender's identifier


@dataclass(frozen=True)
class Attachment:
    """The attachment of a message: its sender's identifier, and its number."""

    number: int
    sender: bytes

    @classmethod
    def read(cls, payload: bytes) -> Attachment | None:
        """Read an attachment; None if bytes are none."""
        if len(payload) != _LAYOUT.size:
            return None
        number, _, length, sender = _LAYOUT.unpack(payload)
        return cls(number, sender) if length == _ID_BYTES else None

    def write(self) -> bytes:
        """Return its bytes, with the present time."""
        return _LAYOUT.pack(self.number, time.time_ns(), _ID_BYTES, self.sender)
