"""Zenoh links of a service: their settings, sockets that are closed without waiting, and a test query over loopback.

The wire page tells `READ_WITHIN`, `LEASE` and `LONGEST_MESSAGE` by `rules.py`: after a change, `tools/wire_page`. The
settings of the link to ROS 2 nodes are here, without any import of ROS's types, which only some installations have.
"""

from __future__ import annotations

import contextlib
import enum
import json
import socket
import struct
import time
from dataclasses import dataclass
from pathlib import Path

import zenoh

from guidefield.errors import strip_source
from guidefield.messages import codec
from guidefield.pool.outbox import MAX_THREADS

ROS_USER = "ros"  # the one user as whom all nodes ask
LATCHING = ("timestamping/enabled", "true")
"""The setting of Zenoh with which a latched message is kept for later subscribers."""


class Distribution(enum.StrEnum):
    """A distribution whose nodes find the service by its type hashes; `ros/rmw_zenoh.py` has the types of each."""

    JAZZY = "jazzy"
    KILTED = "kilted"
    LYRICAL = "lyrical"
    ROLLING = "rolling"


@dataclass(frozen=True)
class RosSettings:
    """How the service is offered to ROS 2 nodes."""

    robot: str  # the one robot that is offered; a name that the service knows
    domain: int = 0  # ROS domain
    distribution: Distribution = Distribution.JAZZY  # of the nodes
    # zenoh endpoint of a router, rmw_zenohd's, that nodes are reached through, in a session of its own as its client;
    # None: nodes reach the service's own session
    connect: str | None = None


READ_WITHIN = 15.0  # time for reading an answer, beside what the system keeps of it, before its link is ended [s]
LEASE = 10.0
"""Longest time until a link that was cut silently is noticed [s].

It is Zenoh's own: with 2 s a service on a busy machine lost its links, and with them the answers.
"""
LONGEST_MESSAGE = 4 * codec.MAX_REQUEST_BYTES
"""Size of the largest message [bytes], well above `MAX_REQUEST_BYTES`: Zenoh drops a larger one without an answer."""
RUNTIME = f"(rx: (worker_threads: 32), tx: (worker_threads: {MAX_THREADS + 4}))"
"""Zenoh's threads, unless the variable ZENOH_RUNTIME says otherwise.

If a link ends while an answer is sent to it, Zenoh blocks one of the threads that send until the answer's own thread
gives up, for up to `READ_WITHIN`. So there are more of them than answers are sent at once; with Zenoh's own four, four
stopped clients would delay all other links' answers. Threads that receive call the endpoint: with four, six flooding
links make the others' queries wait three times as long. The number of threads for queries' time-outs is Zenoh's, one:
four wake one another twice for each query.
"""
DEFAULT_SETTINGS = {
    "scouting/multicast/enabled": "false",
    "scouting/gossip/enabled": "false",
    "transport/link/tx/lease": f"{1e3 * LEASE:.0f}",  # [ms]
    "transport/link/tx/queue/congestion_control/block/wait_before_close": f"{1e6 * READ_WITHIN:.0f}",  # [us]
    "transport/link/rx/max_message_size": str(LONGEST_MESSAGE),
}
"""Settings that replace Zenoh's defaults, unless the configuration sets them: no scouting, bounded messages."""
DESCRIPTORS = Path("/dev/fd")  # folder that lists the open files of a process, on Linux and macOS
NO_LINGER = struct.pack("ii", 0, 0)  # value of SO_LINGER: off, and its time


def close_links_at_once(session: zenoh.Session) -> zenoh.LinkEventsListener[None]:
    """Have every link of a session closed without waiting, later ones too, until the returned listener ends.

    When Zenoh closes a TCP or TLS socket, the system waits up to ten seconds until the other end has read the sent data
    (`SO_LINGER`, not configurable in Zenoh 1.10), in the threads that receive, accept and manage all links. If many
    links with unread data end, no other one is served then. Without that option closing returns at once, and the
    system sends the rest in the background.
    """

    def hear(event: zenoh.LinkEvent) -> None:
        if event.kind == zenoh.SampleKind.PUT:
            close_sockets_at_once()

    return session.info.declare_link_events_listener(hear, history=True)


def close_sockets_at_once() -> None:
    """Have no TCP socket of this process wait for its reader when it is closed, which only Zenoh's would do."""
    for number in DESCRIPTORS.iterdir():
        try:
            found = socket.socket(fileno=int(number.name))
        except OSError:  # no socket, or closed by now
            continue
        with contextlib.suppress(OSError):  # closed by now
            if found.type == socket.SOCK_STREAM and found.family in (socket.AF_INET, socket.AF_INET6):
                found.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, NO_LINGER)
        found.detach()  # it stays Zenoh's


LOOPBACK = "127.0.0.1"  # address of this machine alone, on which nobody else reaches a service
DEFAULT_LISTEN = f"tcp/{LOOPBACK}:7447"  # default endpoint of a service: `DEFAULT_ENDPOINT` of `client/session.py`, too
KEY = "guidefield-doctor/answer"  # of the test query
TIMEOUT_S = 5.0  # time-out of the test query, and of connecting [s]


class NoAnswer(RuntimeError):
    """A query on loopback wasn't answered; says why."""


def measure_answer() -> float:
    """Measure a query from one session on loopback to another and back [s].

    Raises NoAnswer if it isn't answered within `TIMEOUT_S`, or a session can't be opened.
    """
    try:
        with contextlib.ExitStack() as opened:
            held = opened.enter_context(socket.socket())
            held.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            held.bind((LOOPBACK, 0))
            endpoint = f"tcp/{LOOPBACK}:{held.getsockname()[1]}"
            service = opened.enter_context(zenoh.open(_config("peer", "listen", endpoint)))
            opened.enter_context(service.declare_queryable(KEY, _answer))
            client = opened.enter_context(zenoh.open(_config("client", "connect", endpoint)))
            began = time.monotonic()
            if not any(reply.ok is not None for reply in client.get(KEY, timeout=TIMEOUT_S)):
                raise NoAnswer(f"a query at {endpoint} got none within {TIMEOUT_S:g} s")
            return time.monotonic() - began
    except (zenoh.ZError, OSError) as error:
        raise NoAnswer(strip_source(error)) from None


def _answer(query: zenoh.Query) -> None:
    with query:
        query.reply(KEY, b"here")


def _config(mode: str, way: str, endpoint: str) -> zenoh.Config:
    config = zenoh.Config()
    for key, value in DEFAULT_SETTINGS.items():
        config.insert_json5(key, value)
    config.insert_json5("mode", json.dumps(mode))
    config.insert_json5("listen/endpoints", "[]")
    config.insert_json5(f"{way}/endpoints", json.dumps([endpoint]))
    return config


def is_taken(endpoint: str) -> bool:
    """Return whether somebody listens at an endpoint of this machine, such as `DEFAULT_LISTEN`."""
    host, _, port = endpoint.partition("/")[2].rpartition(":")
    with socket.socket() as probe:
        probe.settimeout(TIMEOUT_S)
        return probe.connect_ex((host, int(port))) == 0
