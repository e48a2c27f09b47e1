"""Names of ROS entities on Zenoh: data keys, liveliness tokens of which ROS makes its graph, and attachments.

As in the design document of rmw_zenoh, which has to be kept to the letter: a service or topic has the key
``<domain>/<name>/<type>/<hash>``, and each node, publisher, subscription and service declares a token below
``@ros2_lv``. In tokens a slash of a name is a percent sign.
"""

from __future__ import annotations

import enum
import struct
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass

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
