"""A Zenoh session that talks to the endpoints it is given, and to nobody else."""

from __future__ import annotations

import json
import re
import socket
import time
from itertools import chain
from pathlib import Path

import zenoh

from guidefield.errors import NoService, without_source
from guidefield.messages.identities import PLAIN, checked_user

LOOK_AGAIN = 0.05
"""How often something that isn't there yet is looked for [s]."""
OVER_TCP = ("tcp", "tls", "ws")
"""Protocols of Zenoh's that go over TCP."""
ANSWERS_WITHIN = 1.0
"""How long it is looked whether anybody listens at all [s]."""
RETRY = {"period_init_ms": 200, "period_max_ms": 1_000, "period_increase_factor": 1.5}
"""How often a cut link is tried again; the configuration's own word for it counts more."""


def opened(settings: zenoh.Config, deadline: float) -> zenoh.Session:
    """A session.

    Args:
        settings: As `configured` makes them.
        deadline: How long to try, by `time.monotonic()` [s].

    Raises:
        NoService: if nobody listens there, or who does doesn't let us in.
    """
    while True:
        try:
            return zenoh.open(settings)
        except zenoh.ZError as error:
            if time.monotonic() > deadline:
                raise unreachable(settings, without_source(error)) from None
        time.sleep(LOOK_AGAIN)


def unreachable(settings: zenoh.Config, reason: str) -> NoService:
    """Why there is no link to any endpoint: nobody listens there, or who does lets nobody in who comes like this.

    Zenoh says the same of a wrong password as of a port where nobody is.
    """
    endpoints = _endpoints(settings)
    where = ", ".join(endpoints)
    if any(map(_listened_at, endpoints)):
        words = f"{where} listens, but doesn't let this client in: look at user, password, certificates and protocol"
    else:
        words = f"nobody listens at {where}; `guidefield serve` starts a service"
    return NoService(f"{words}: {reason}", endpoints=endpoints)


def _endpoints(settings: zenoh.Config) -> list[str]:
    """Where a configuration connects to."""
    told = json.loads(settings.get_json("connect/endpoints"))
    return [str(one) for one in (told if isinstance(told, list) else chain.from_iterable(told.values()))]


def _listened_at(endpoint: str) -> bool:
    """Return whether somebody takes TCP's connections there; False where the protocol is another one."""
    protocol, _, address = endpoint.partition("/")
    host, _, port = re.split("[?#]", address)[0].rpartition(":")
    if protocol not in OVER_TCP or not port.isdecimal():
        return False
    try:
        socket.create_connection((host.strip("[]"), int(port)), ANSWERS_WITHIN).close()
    except (OSError, OverflowError):
        return False
    return True


def linked(session: zenoh.Session) -> bool:
    """Return whether a session has a link to anybody."""
    return bool(list(session.info.peers_zid()) or list(session.info.routers_zid()))


def configured_user(settings: zenoh.Config) -> str:
    """The user that a configuration names, in what Zenoh leaves to others to say: ``metadata: {guidefield: {user}}``.

    Raises:
        MalformedRequest: if nobody can be a user of that name.
    """
    told = json.loads(settings.get_json("metadata"))
    ours = told.get("guidefield") if isinstance(told, dict) else None
    user = ours.get("user") if isinstance(ours, dict) else None
    return PLAIN if user is None else checked_user(str(user))


def configured(endpoints: tuple[str, ...], config: Path | None) -> zenoh.Config:
    """Settings of a session; to a single endpoint as a client, to several as a peer that is connected to each.

    Args:
        endpoints: Where services or routers listen; may be none where the configuration names some.
        config: Zenoh configuration file: users, certificates.

    Raises:
        ValueError: if an endpoint isn't one, or the configuration is wrong.
    """
    try:
        settings = zenoh.Config() if config is None else zenoh.Config.from_file(str(config))
    except zenoh.ZError as error:
        raise ValueError(f"the Zenoh configuration {str(config)!r} is wrong: {without_source(error)}") from None
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
