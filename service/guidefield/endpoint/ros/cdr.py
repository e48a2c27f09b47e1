"""Messages to bytes and back (CDR), and the hashes of their types (RIHS01), by the library rosbags.

A message is an object with the fields of its type: numbers, texts, other messages, lists of them, and NumPy arrays
where a field has many numbers. Types are named as ROS does: ``std_msgs/msg/String``,
``moveit_msgs/srv/GetMotionPlan_Request``. Fields, their order and names of types must be those of the distribution: a
type with another hash is another type for its nodes.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import resources
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from guidefield.endpoint.ros.options import Distribution

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
            definitions |= _parsed(name.replace("/", "/msg/"), fields)
        for name, (request, response) in services.items():
            own = name.replace("/", "/srv/")
            definitions |= _service(own, _parsed(f"{own}_Request", request), _parsed(f"{own}_Response", response))
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


def _parsed(name: str, fields: str) -> dict[str, Any]:
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
        **_parsed(f"{name}_Goal", goal),
        **_parsed(f"{name}_Result", result),
        **_parsed(f"{name}_Feedback", feedback),
        **_service(
            send,
            with_id(f"{send}_Request", ("goal", one(f"{name}_Goal"))),
            _parsed(f"{send}_Response", "bool accepted\nbuiltin_interfaces/Time stamp"),
        ),
        **_service(get, with_id(f"{get}_Request"), {f"{get}_Response": ([], got)}),
        **with_id(f"{name}_FeedbackMessage", ("feedback", one(f"{name}_Feedback"))),
    }


def _service(name: str, request: dict[str, Any], response: dict[str, Any]) -> dict[str, Any]:
    def one(of: str) -> tuple[Nodetype, str]:
        return Nodetype.NAME, of

    def at_most_one(of: str) -> tuple[Nodetype, Any]:
        return Nodetype.SEQUENCE, (one(of), 1)

    asked, answered, event = f"{name}_Request", f"{name}_Response", f"{name}_Event"
    return {
        **request,
        **response,
        event: (
            [],
            [
                ("info", one("service_msgs/msg/ServiceEventInfo")),
                ("request", at_most_one(asked)),
                ("response", at_most_one(answered)),
            ],
        ),
        name: (
            [],
            [("request_message", one(asked)), ("response_message", one(answered)), ("event_message", one(event))],
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
