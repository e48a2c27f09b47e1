"""A session of this process that answers another one, to see that Zenoh works on this machine."""

from __future__ import annotations

import contextlib
import json
import socket
import time

import zenoh

from guidefield.endpoint.link import UNLESS_TOLD
from guidefield.errors import without_source

LOOPBACK = "127.0.0.1"
DEFAULT_LISTEN = f"tcp/{LOOPBACK}:7447"
"""Where a service listens unless it is told otherwise."""
KEY = "guidefield-doctor/answer"
WITHIN = 5.0
"""How long an answer is waited for [s]."""


class NoAnswer(RuntimeError):
    """A query on loopback wasn't answered; says why."""


def seconds_to_answer() -> float:
    """How long a query takes from one session on loopback to another and back [s].

    Raises:
        NoAnswer: if it isn't answered within `WITHIN`, or a session can't be opened.
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
            if not any(reply.ok is not None for reply in client.get(KEY, timeout=WITHIN)):
                raise NoAnswer(f"a query at {endpoint} got none within {WITHIN:g} s")
            return time.monotonic() - began
    except (zenoh.ZError, OSError) as error:
        raise NoAnswer(without_source(error)) from None


def _answer(query: zenoh.Query) -> None:
    with query:
        query.reply(KEY, b"here")


def _config(mode: str, way: str, endpoint: str) -> zenoh.Config:
    config = zenoh.Config()
    for key, value in UNLESS_TOLD.items():
        config.insert_json5(key, value)
    config.insert_json5("mode", json.dumps(mode))
    config.insert_json5("listen/endpoints", "[]")
    config.insert_json5(f"{way}/endpoints", json.dumps([endpoint]))
    return config


def taken(endpoint: str) -> bool:
    """Whether somebody listens at an endpoint of this machine, such as `DEFAULT_LISTEN`."""
    host, _, port = endpoint.partition("/")[2].rpartition(":")
    with socket.socket() as probe:
        probe.settimeout(WITHIN)
        return probe.connect_ex((host, int(port))) == 0
