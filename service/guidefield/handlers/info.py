"""The reply of a service about itself: its versions, limits, figures and rules.

The brief reply must stay cheap: clients of several instances ask for it each `MAX_REPORT_AGE_S` (client/exchange.py).
"""

from __future__ import annotations

import functools
import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path

import msgspec

from guidefield.messages import codec
from guidefield.messages.keys import KEYS
from guidefield.messages.replies import (
    DeliveryRule,
    Disk,
    Health,
    Histogram,
    Identity,
    InfoReply,
    LimitInfo,
    UserFigures,
)
from guidefield.messages.schemas import make_schemas
from guidefield.messages.service import CODES
from guidefield.system import resident

PACKAGES = ("pin", "coal", "numba", "numpy", "eclipse-zenoh", "rerun-sdk", "example-robot-data", "msgspec")
"""Packages whose versions a bug report should name; without one of them here a full `info` fails."""


@dataclass(frozen=True)
class Figures:
    """The counters and measures of a service: the fields of InfoReply of the same names."""

    counters: Mapping[str, int]
    uptime: float
    workers: int = 0
    busy: int = 0
    queue: int = 0
    memory: int = 0
    latency: Mapping[str, Histogram] = field(default_factory=dict)
    health: Health = field(default_factory=Health)
    disk: Disk | None = None
    identity: Identity | None = None
    users: Mapping[str, UserFigures] = field(default_factory=dict)
    streams: int = 0


@dataclass(frozen=True)
class Rules:
    """The rules of a service: the fields of InfoReply of the same names; empty if there is no service."""

    limits: tuple[LimitInfo, ...] = ()
    delivery: tuple[DeliveryRule, ...] = ()


def info(figures: Figures, rules: Rules | None = None) -> InfoReply:
    """Versions, keys, codes, rules, the JSON Schema of every message, and the figures given."""
    rules = rules or Rules()
    return msgspec.structs.replace(
        brief_info(figures),
        packages={package: _version(package) for package in PACKAGES},
        keys=list(KEYS),
        codes=list(CODES),
        limits=list(rules.limits),
        delivery=list(rules.delivery),
        schemas=make_schemas(),
    )


def brief_info(figures: Figures) -> InfoReply:
    """The figures, without what stays the same while a service runs."""
    return InfoReply(
        version=_version("guidefield"),
        packages={},
        schemas={},
        workers=figures.workers,
        busy=figures.busy,
        queue=figures.queue,
        memory=figures.memory,
        counters=dict(figures.counters),
        uptime=figures.uptime,
        latency=dict(figures.latency),
        health=figures.health,
        own_memory=resident(os.getpid()),
        disk=figures.disk,
        payload_limit=codec.MAX_REQUEST_BYTES,
        identity=figures.identity,
        users=dict(figures.users),
        streams=figures.streams,
    )


def disk_of(folder: Path) -> Disk | None:
    """Size and free space of the disk that a folder is on; None where they can't be read."""
    try:
        found = shutil.disk_usage(folder)
    except OSError:
        return None
    return Disk(free=found.free, total=found.total)


_version = functools.cache(version)
