"""What a service says about itself."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.metadata import version
from typing import Any

import msgspec

from guidefield.messages import codec
from guidefield.messages.replies import Histogram, InfoReply

PACKAGES = ("pin", "coal", "numba", "numpy", "eclipse-zenoh", "rerun-sdk", "example-robot-data", "msgspec")
"""Packages whose versions a bug report should name."""


@dataclass(frozen=True)
class Figures:
    """What a service counts and measures: the fields of InfoReply of the same names."""

    counters: Mapping[str, int]
    uptime: float
    workers: int = 0
    busy: int = 0
    queue: int = 0
    memory: int = 0
    latency: Mapping[str, Histogram] = field(default_factory=dict)


def info(figures: Figures) -> InfoReply:
    """Versions, the JSON Schema of every message, and the figures given."""
    packages = {package: version(package) for package in PACKAGES}
    return msgspec.structs.replace(brief_info(figures), packages=packages, schemas=_schemas())


def brief_info(figures: Figures) -> InfoReply:
    """The figures, without the packages' versions and the schemas."""
    return InfoReply(
        version=_version(),
        packages={},
        schemas={},
        workers=figures.workers,
        busy=figures.busy,
        queue=figures.queue,
        memory=figures.memory,
        counters=dict(figures.counters),
        uptime=figures.uptime,
        latency=dict(figures.latency),
    )


@functools.cache
def _version() -> str:
    return version("guidefield")


@functools.cache
def _schemas() -> dict[str, Any]:
    return codec.json_schemas()
