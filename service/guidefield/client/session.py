"""Open a client's Zenoh session, which connects to the given endpoints only, and explain why it has no link.

`RETRY` decides how soon a cut link is back, before the service gives the client up (`endpoint/under_way.py` `GRACE`).
"""

from __future__ import annotations

import json
import re
import socket
import time
from itertools import chain
from pathlib import Path

import zenoh

from guidefield.errors import NoService, strip_source
from guidefield.messages.identities import PLAIN, check_user

RETRY_PERIOD = 0.05  # time between two attempts to find a service [s]
TCP_PROTOCOLS = ("tcp", "tls", "ws")  # protocols of Zenoh that run over TCP
CONNECT_TIMEOUT = 1.0  # time that an endpoint has to accept a TCP connection [s]
RETRY = {"period_init_ms": 200, "period_max_ms": 1_000, "period_increase_factor": 1.5}
"""Periods of attempts to restore a cut link, unless the configuration gives its own."""


def open_session(settings: zenoh.Config, deadline: float) -> zenoh.Session:
    """Open a session, trying until a deadline.

    Raises NoService if nobody listens there, or the listener rejects this client.
    """
    while True:
        try:
            return zenoh.open(settings)
        except zenoh.ZError as error:
            if time.monotonic() > deadline:
                raise explain_no_link(settings, strip_source(error)) from None
        time.sleep(RETRY_PERIOD)


def explain_no_link(settings: zenoh.Config, reason: str) -> NoService:
    """Explain why no endpoint is linked: nobody listens, or the listener rejects this client.

    Zenoh gives the same error for a wrong password as for a port without a listener.
    """
    endpoints = _endpoints(settings)
    where = ", ".join(endpoints)
    if any(map(_is_listening, endpoints)):
        words = f"{where} listens, but doesn't let this client in: look at user, password, certificates and protocol"
    else:
        words = f"nobody listens at {where}; `guidefield serve` starts a service"
    return NoService(f"{words}: {reason}", endpoints=endpoints)


def _endpoints(settings: zenoh.Config) -> list[str]:
    given = json.loads(settings.get_json("connect/endpoints"))
    return [str(one) for one in (given if isinstance(given, list) else chain.from_iterable(given.values()))]


def _is_listening(endpoint: str) -> bool:
    protocol, _, address = endpoint.partition("/")
    host, _, port = re.split("[?#]", address)[0].rpartition(":")
    if protocol not in TCP_PROTOCOLS or not port.isdecimal():
        return False
    try:
        socket.create_connection((host.strip("[]"), int(port)), CONNECT_TIMEOUT).close()
    except (OSError, OverflowError):
        return False
    return True


def has_link(session: zenoh.Session) -> bool:
    """Return whether a session has a link to a service or a router."""
    return bool(list(session.info.peers_zid()) or list(session.info.routers_zid()))


def read_user(settings: zenoh.Config) -> str:
    """Read the user that a configuration names in Zenoh's free metadata, ``metadata: {guidefield: {user}}``.

    Raises MalformedRequest if it can't be a user's name.
    """
    metadata = json.loads(settings.get_json("metadata"))
    ours = metadata.get("guidefield") if isinstance(metadata, dict) else None
    user = ours.get("user") if isinstance(ours, dict) else None
    return PLAIN if user is None else check_user(str(user))


def build_config(endpoints: tuple[str, ...], config: Path | None) -> zenoh.Config:
    """Build the configuration of a session: a client of one endpoint, or a peer linked to each of several.

    Raises ValueError if an endpoint isn't one, or the configuration is wrong.
    """
    try:
        settings = zenoh.Config() if config is None else zenoh.Config.from_file(str(config))
    except zenoh.ZError as error:
        raise ValueError(f"the Zenoh configuration {str(config)!r} is wrong: {strip_source(error)}") from None
    if endpoints:
        try:
            settings.insert_json5("connect/endpoints", json.dumps(endpoints))
        except zenoh.ZError as error:
            raise ValueError(f"endpoints are written like tcp/127.0.0.1:7447, got {', '.join(endpoints)}") from error
    if len(json.loads(settings.get_json("connect/endpoints"))) > 1:
        settings.insert_json5("mode", '"peer"')
        settings.insert_json5("listen/endpoints", "[]")
    else:
        settings.insert_json5("mode", '"client"')
    if json.loads(settings.get_json("connect/retry")) is None:
        settings.insert_json5("connect/retry", json.dumps(RETRY))
    for scouting in ("multicast", "gossip"):
        settings.insert_json5(f"scouting/{scouting}/enabled", "false")
    return settings
