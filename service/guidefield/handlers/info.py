"""What a service says about itself."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from importlib.metadata import version
from typing import Any

from guidefield.messages import codec
from guidefield.messages.replies import InfoReply

PACKAGES = ("pin", "coal", "numba", "numpy", "eclipse-zenoh", "rerun-sdk", "example-robot-data", "msgspec")
"""Packages whose versions a bug report should name."""


def info(*, workers: int, queue: int, counters: Mapping[str, int], uptime: float) -> InfoReply:
    """Versions, the JSON Schema of every message, and the figures given.

    Args:
        workers: Processes that work on requests; 0 where the caller's own process does.
        queue: Requests that wait.
        counters: What was counted since the start.
        uptime: Time since the start [s].
    """
    return InfoReply(
        version=version("guidefield"),
        packages={package: version(package) for package in PACKAGES},
        schemas=_schemas(),
        workers=workers,
        queue=queue,
        counters=dict(counters),
        uptime=uptime,
    )


@functools.cache
def _schemas() -> dict[str, Any]:
    return codec.json_schemas()
