import contextlib
import json
import os
import socket
import struct
from collections.abc import Iterator

import zenoh

from guidefield.cli.serving import LOOPBACK, free_port
from guidefield.endpoint.link import DESCRIPTORS, close_links_at_once, close_sockets_at_once
from tests.journeys.service import await_that

LINGERING = struct.pack("ii", 1, 10)


@contextlib.contextmanager
def _session(way: str, port: int) -> Iterator[zenoh.Session]:
    config = zenoh.Config()
    for key, value in {
        "mode": "peer" if way == "listen" else "client",
        "listen/endpoints": [],
        f"{way}/endpoints": [f"tcp/{LOOPBACK}:{port}"],
        "scouting/multicast/enabled": False,
    }.items():
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config) as session:
        yield session


def _links(port: int) -> list[bool]:
    """Of each link that was taken at a port, whether it waits for its reader when it is closed."""
    found = []
    for number in DESCRIPTORS.iterdir():
        try:
            one = socket.socket(fileno=int(number.name))
        except OSError:
            continue
        with contextlib.suppress(OSError):
            if one.getpeername() and one.getsockname() == (LOOPBACK, port):
                found.append(_lingers(one))
        one.detach()
    return found


def _lingers(one: socket.socket) -> bool:
    told = one.getsockopt(socket.SOL_SOCKET, socket.SO_LINGER, len(LINGERING))
    return bool(struct.unpack("ii", told)[0])


def test_zenoh_waits_for_readers_and_here_no_link_does() -> None:
    """The links that are there, and those that come later; where the first line fails, Zenoh waits no more."""
    with free_port() as port, _session("listen", port) as service, _session("connect", port):
        await_that(lambda: _links(port) == [True])
        with close_links_at_once(service):
            await_that(lambda: _links(port) == [False])
            with _session("connect", port):
                await_that(lambda: _links(port) == [False, False])


def test_open_files_that_are_no_links_are_left_as_they_are() -> None:
    near, far = socket.socketpair()
    reading, writing = os.pipe()
    with near, far, socket.socket() as link, os.fdopen(reading), os.fdopen(writing, "wb"):
        for one in (near, link):
            one.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, LINGERING)
        close_sockets_at_once()
        assert [_lingers(one) for one in (near, link)] == [True, False]
        near.sendall(b"here")
        assert far.recv(4) == b"here"
