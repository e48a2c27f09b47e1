"""A Zenoh session that talks to the endpoints it is given, and to nobody else."""

from __future__ import annotations

import json
import time
from pathlib import Path

import zenoh

from guidefield.errors import NoService, without_source

LOOK_AGAIN = 0.05
"""How often something that isn't there yet is looked for [s]."""
LEASE = 2_000
"""How long a cut link may go unnoticed [ms]."""
RETRY = {"period_init_ms": 200, "period_max_ms": 1_000, "period_increase_factor": 1.5}
"""How often a cut link is tried again; the configuration's own word for it counts more."""


def opened(endpoints: tuple[str, ...], config: Path | None, deadline: float) -> zenoh.Session:
    """A session; to a single endpoint as a client, to several as a peer that is connected to each.

    Args:
        endpoints: Where services or routers listen; may be none where the configuration names some.
        config: Zenoh configuration file: users, certificates.
        deadline: How long to try, by `time.monotonic()` [s].

    Raises:
        NoService: if nobody listens there.
        ValueError: if an endpoint isn't one, or the configuration is wrong.
    """
    settings = _configured(endpoints, config)
    while True:
        try:
            return zenoh.open(settings)
        except zenoh.ZError as error:
            if time.monotonic() > deadline:
                where = ", ".join(endpoints) or str(config)
                raise NoService(
                    f"nobody listens at {where}: {without_source(error)}", endpoints=list(endpoints)
                ) from None
        time.sleep(LOOK_AGAIN)


def _configured(endpoints: tuple[str, ...], config: Path | None) -> zenoh.Config:
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
    settings.insert_json5("transport/link/tx/lease", str(LEASE))
    if json.loads(settings.get_json("connect/retry")) is None:
        settings.insert_json5("connect/retry", json.dumps(RETRY))
    for scouting in ("multicast", "gossip"):
        settings.insert_json5(f"scouting/{scouting}/enabled", "false")
    return settings
