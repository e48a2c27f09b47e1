"""Names of ROS entities on Zenoh: data keys, and the liveliness tokens of which ROS makes its graph.

After the design document of rmw_zenoh: a service or topic has the key ``<domain>/<name>/<type>/<hash>``, and each node,
publisher, subscription and service declares a token below ``@ros2_lv``. In tokens a slash of a name is a percent sign.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass

GRAPH = "@ros2_lv"
"""The first chunk of every token."""
DEFAULT_QOS = "::,10:,:,:,,"
"""Reliable, volatile, the last ten: what rmw_zenoh leaves out is its default."""
LATCHED_QOS = ":1:,1:,:,:,,"
"""Reliable, transient local, the last one: who comes later gets it, too."""


class Kind(enum.StrEnum):
    """What a token stands for."""

    NODE = "NN"
    PUBLISHER = "MP"
    SUBSCRIPTION = "MS"
    SERVICE = "SS"
    CLIENT = "SC"


@dataclass(frozen=True)
class Entity:
    """A service, publisher or subscription.

    Attributes:
        kind: Which of them.
        name: Without the first slash, such as ``plan_kinematic_path``.
        type_name: Such as ``moveit_msgs/srv/GetMotionPlan``.
        type_hash: Of that type.
        qos: As a token has it.
    """

    kind: Kind
    name: str
    type_name: str
    type_hash: str
    qos: str = DEFAULT_QOS

    @property
    def on_zenoh(self) -> str:
        """The name of its type in keys and tokens, such as ``moveit_msgs::srv::dds_::GetMotionPlan_``."""
        package, kind, name = self.type_name.split("/")
        return f"{package}::{kind}::dds_::{name}_"

    def key(self, domain: int) -> str:
        """The key of its data in a domain."""
        return f"{domain}/{self.name}/{self.on_zenoh}/{self.type_hash}"


@dataclass(frozen=True)
class Node:
    """A node of a session.

    Attributes:
        domain: ROS domain.
        session: The Zenoh id of its session.
        name: Its name; it has no namespace.
    """

    domain: int
    session: str
    name: str

    def token(self) -> str:
        """The token of the node itself."""
        return f"{self._base(0, Kind.NODE)}/%/%/{self.name}"

    def token_of(self, number: int, entity: Entity) -> str:
        """The token of one of its entities, which are numbered from 1."""
        return (
            f"{self._base(number, entity.kind)}/%/%/{self.name}"
            f"/%{entity.name.replace('/', '%')}/{entity.on_zenoh}/{entity.type_hash}/{entity.qos}"
        )

    def _base(self, number: int, kind: Kind) -> str:
        return f"{GRAPH}/{self.domain}/{self.session}/0/{number}/{kind}"


@dataclass(frozen=True)
class Seen:
    """What a token of another node says.

    Attributes:
        node: The node's name.
        kind: What the token stands for.
        name: Of the service or topic, without the first slash.
        on_zenoh: Name of its type, as in keys.
        type_hash: Of that type.
    """

    node: str
    kind: str
    name: str
    on_zenoh: str
    type_hash: str

    @classmethod
    def read(cls, token: str) -> Seen | None:
        """What a token says; None where it is a node's, or none of ROS."""
        chunks = token.split("/")
        if len(chunks) != 13 or chunks[0] != GRAPH:
            return None
        kind, _, space, node, name, on_zenoh, type_hash = chunks[5:12]
        return cls(
            f"{space}/{node}".replace("%", "/").lstrip("/"), kind, name.replace("%", "/")[1:], on_zenoh, type_hash
        )
