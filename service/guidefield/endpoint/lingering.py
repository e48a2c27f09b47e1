"""A link that ends holds up no thread: its socket is closed without waiting for who doesn't read.

Theory of operation. Zenoh has the system wait, when a TCP or TLS socket is closed, until the other end has read what
was sent, for up to ten seconds (`SO_LINGER`, not configurable in Zenoh 1.10), and closes sockets in the threads that
receive, accept and manage all links. When the links of many end to which something is still being sent, nobody else is
served meanwhile. Without that option closing returns at once, and the system goes on to send what is left by itself.
"""

from __future__ import annotations

import contextlib
import socket
import struct
from pathlib import Path

import zenoh

DESCRIPTORS = Path("/dev/fd")
"""Where the system lists the open files of a process; Linux and macOS do."""
AT_ONCE = struct.pack("ii", 0, 0)
"""The option's value: off, and its time."""


def close_links_at_once(session: zenoh.Session) -> zenoh.LinkEventsListener[None]:
    """Have every link of a session closed without waiting, those that come later too, until what it returns ends."""

    def opened(event: zenoh.LinkEvent) -> None:
        if event.kind == zenoh.SampleKind.PUT:
            close_sockets_at_once()

    return session.info.declare_link_events_listener(opened, history=True)


def close_sockets_at_once() -> None:
    """Have no TCP socket of this process wait for its reader when it is closed; only Zenoh's do."""
    for number in DESCRIPTORS.iterdir():
        try:
            found = socket.socket(fileno=int(number.name))
        except OSError:  # no socket, or closed meanwhile
            continue
        with contextlib.suppress(OSError):  # closed meanwhile
            if found.type == socket.SOCK_STREAM and found.family in (socket.AF_INET, socket.AF_INET6):
                found.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, AT_ONCE)
        found.detach()  # it stays Zenoh's
