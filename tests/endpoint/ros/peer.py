"""A ROS node's stand-in: it knows the keys, attachments and messages, and asks as rmw_zenoh does."""

import contextlib
import json
import queue
import struct
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import zenoh

from guidefield.endpoint.link import Distribution
from guidefield.endpoint.ros.rmw_zenoh import types_of

TYPES = types_of(Distribution.JAZZY)
new = TYPES.new
SENDER = bytes(range(16))
ANSWERED_WITHIN = 120.0


def key(name: str, type_name: str, domain: int = 0) -> str:
    """Where rmw_zenoh has a service or topic; written apart from the room that is tested."""
    package, kind, own = type_name.split("/")
    return f"{domain}/{name}/{package}::{kind}::dds_::{own}_/{TYPES.type_hash(type_name)}"


def attachment(number: int = 1, sender: bytes = SENDER) -> bytes:
    return struct.pack("<qq", number, time.time_ns()) + bytes([len(sender)]) + sender


@dataclass
class Peer:
    """Asks services, and publishes and hears topics."""

    session: zenoh.Session
    domain: int = 0
    _number: int = 0
    heard: dict[str, queue.Queue[Any]] = field(default_factory=dict)

    def replies(self, name: str, service: str, payload: bytes, attached: bytes | None = None) -> list[zenoh.Reply]:
        self._number += 1
        found = self.session.get(
            key(name, f"moveit_msgs/srv/{service}", self.domain),
            payload=payload,
            attachment=attachment(self._number) if attached is None else attached,
            target=zenoh.QueryTarget.ALL_COMPLETE,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=ANSWERED_WITHIN,
        )
        return list(found)

    def call(self, name: str, service: str, **fields: Any) -> Any:
        """The response to a request; there must be exactly one, with the number and the sender of the request."""
        asked = TYPES.write(new(f"moveit_msgs/srv/{service}_Request", **fields), f"moveit_msgs/srv/{service}_Request")
        (reply,) = self.replies(name, service, asked)
        assert reply.ok is not None, reply.err.payload.to_string()
        told = reply.ok.attachment.to_bytes()
        assert struct.unpack("<q", told[:8]) == (self._number,)
        assert told[16:] == bytes([16]) + SENDER
        return TYPES.read(reply.ok.payload.to_bytes(), f"moveit_msgs/srv/{service}_Response")

    def publish(self, name: str, type_name: str, message: Any) -> None:
        self._number += 1
        payload = TYPES.write(message, type_name)
        self.session.put(key(name, type_name, self.domain), payload, attachment=attachment(self._number))

    def listen(self, name: str, type_name: str) -> queue.Queue[Any]:
        """Messages that are published from now on."""
        found: queue.Queue[Any] = queue.Queue()
        self.session.declare_subscriber(
            key(name, type_name, self.domain),
            lambda sample: found.put(TYPES.read(sample.payload.to_bytes(), type_name)),
        )
        return found


@contextlib.contextmanager
def peer_at(endpoint: str, domain: int = 0) -> Iterator[Peer]:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(config) as session:
        yield Peer(session, domain)
