"""Connect a client: open its Zenoh session, to the given endpoints only, or explain why it has no link; show its runs.

`RETRY` decides how soon a cut link is back, before the service gives the client up (`endpoint/under_way.py` `GRACE`).
Recordings of runs are fetched and sent to a Rerun viewer in a thread of its own; what fails there is logged, and never
reaches the caller.
"""

from __future__ import annotations

import json
import logging
import re
import socket
import time
from concurrent.futures import ThreadPoolExecutor
from itertools import chain
from pathlib import Path

import zenoh

from guidefield.client import questions
from guidefield.client.exchange import Exchange, await_answer
from guidefield.errors import GuidefieldError, NoService, strip_source
from guidefield.messages.identities import PLAIN, check_user
from guidefield.messages.replies import MotionReply
from guidefield.viewer import CannotShow, find_viewer, send_recording

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"  # must be `DEFAULT_LISTEN` of `endpoint/link.py`, which clients don't have
RETRY_PERIOD = 0.05  # time between two attempts to find a service [s]
TCP_PROTOCOLS = ("tcp", "tls", "ws")  # protocols of Zenoh that run over TCP
CONNECT_TIMEOUT = 1.0  # time that an endpoint has to accept a TCP connection [s]
RETRY = {"period_init_ms": 200, "period_max_ms": 1_000, "period_increase_factor": 1.5}
"""Periods of attempts to restore a cut link, unless the configuration gives its own."""


def connect_exchange(
    endpoints: tuple[str, ...], instance: str | None, config: Path | None, user: str | None, wait: float
) -> Exchange:
    """Connect an exchange to a service; raises as `Client.connect`."""
    deadline = time.monotonic() + wait
    where = (DEFAULT_ENDPOINT,) if not endpoints and config is None else endpoints
    settings = build_config(where, config)
    asking = check_user(user) if user is not None else read_user(settings)
    exchange = Exchange(open_session(settings, deadline), instance, asking)
    try:
        exchange.await_instance(deadline - time.monotonic())
    except BaseException as error:
        alone = isinstance(error, NoService) and not has_link(exchange.session)
        exchange.close()
        if alone:
            raise explain_no_link(settings, "there is no link to any of them") from None
        raise
    return exchange


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


_log = logging.getLogger(__name__)


def choose_viewer(show: bool | str) -> str | None:
    """Return the address of the viewer that a caller asks for: this machine's, another one's, or None.

    Raises:
        CannotShow: if there is none on this machine, and none can be started.
    """
    return find_viewer(print) if show is True else show or None


class ShownRuns:
    """Shows one run after the other, in a thread of its own.

    Args:
        exchange: The link over which it queries the recordings.
        viewer: Address of a running viewer; None: nothing is shown.
    """

    def __init__(self, exchange: Exchange, viewer: str | None) -> None:
        self._exchange, self._viewer = exchange, viewer
        self._showing = ThreadPoolExecutor(1, "guidefield-viewer")

    def add(self, reply: object) -> None:
        """Show the run of a reply, if it is recorded, once those before it are shown."""
        if self._viewer is not None and isinstance(reply, MotionReply) and reply.recording is not None:
            self._showing.submit(self._show, reply.run_id, self._viewer)

    def close(self) -> None:
        """Wait until all runs are shown."""
        self._showing.shutdown()

    def _show(self, run_id: str, viewer: str) -> None:
        try:
            question = questions.recording(run_id)
            send_recording(question.read(await_answer(self._exchange.ask(question))), viewer)
        except (CannotShow, GuidefieldError, OSError) as error:
            _log.warning("run %s isn't shown: %s", run_id, error)
