"""Hashes of declared scenes and obstacles, for which each number is read once."""

from __future__ import annotations

from typing import NamedTuple

import msgspec
import numpy as np

from guidefield.bounded_map import content_key
from guidefield.messages import scene as messages
from guidefield.messages.frozen_scenes import Derivation


class Content(NamedTuple):
    """Hashes of a declared obstacle: of all, and of its points and triangles alone, if it is declared by many."""

    all: bytes
    geometry: bytes = b""


_GEOMETRY: dict[type[messages.Obstacle], tuple[str, ...]] = {
    messages.Mesh: ("vertices", "triangles"),
    messages.PointCloud: ("points",),
}
"""Fields that may hold a million numbers, by kind."""


def content_of(message: messages.Obstacle) -> Content:
    """Hash a declared obstacle."""
    fields = _GEOMETRY.get(type(message))
    if fields is None:
        return Content(_hashed(message))
    geometry = _hashed([getattr(message, field) for field in fields])
    rest = {name: value for name, value in msgspec.structs.asdict(message).items() if name not in fields}
    return Content(_hashed([type(message).__name__, rest, geometry]), geometry)


def scene_content(message: messages.Scene) -> tuple[bytes, dict[int, Content]]:
    """The hash of all that is declared of a scene, and those of its meshes and clouds, by index."""
    many = {index: content_of(one) for index, one in enumerate(message.obstacles) if type(one) in _GEOMETRY}
    obstacles = [many[index].all if index in many else one for index, one in enumerate(message.obstacles)]
    return _hashed(msgspec.structs.asdict(message) | {"obstacles": obstacles}), many


def changed_content(before: bytes, change: Derivation, message: messages.Scene) -> tuple[bytes, dict[int, Content]]:
    """Return the hash of a changed scene, of the hash before and the change, and those of others by index."""
    others = [*change.moved, *range(len(message.obstacles) - change.added, len(message.obstacles))]
    fresh = {index: content_of(message.obstacles[index]) for index in others}
    return _hashed([before, message.name, change.removed, others, [one.all for one in fresh.values()]]), fresh


_ENCODER = msgspec.msgpack.Encoder(enc_hook=np.generic.tolist)


def _hashed(declared: object) -> bytes:
    return content_key(_ENCODER.encode(declared))
