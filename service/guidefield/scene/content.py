"""What a scene and its obstacles are known by: hashes of what is declared, for which each number is read once."""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import msgspec
import numpy as np

from guidefield.messages import scene as messages
from guidefield.messages.own_scenes import Before
from guidefield.messages.values import Look, never


class Content(NamedTuple):
    """Hashes of a declared obstacle.

    Attributes:
        all: Of everything that is declared of it.
        geometry: Of its points and triangles alone; of what isn't declared by many, none.
    """

    all: bytes
    geometry: bytes = b""


TOGETHER = 5_000
"""So many triples or obstacles are written in some milliseconds."""

_ARRAY, _MAP = (0x90, 0xDC, 0xDD), (0x80, 0xDE, 0xDF)
"""First bytes of lists and dicts in MessagePack: of fewer than 16, the number in it, of fewer than 2^16, of more."""

_GEOMETRY: dict[type[messages.Obstacle], tuple[str, ...]] = {
    messages.Mesh: ("vertices", "triangles"),
    messages.PointCloud: ("points",),
}
"""Fields that may hold a million numbers, by kind."""


def content_of(message: messages.Obstacle, look: Look = never) -> Content:
    """Hash a declared obstacle; `look` is called again and again where that takes long."""
    fields = _GEOMETRY.get(type(message))
    if fields is None:
        return Content(_hashed(message))
    geometry = _hashed([getattr(message, field) for field in fields], look)
    rest = {name: value for name, value in msgspec.structs.asdict(message).items() if name not in fields}
    return Content(_hashed([type(message).__name__, rest, geometry]), geometry)


def scene_content(message: messages.Scene, look: Look = never) -> tuple[bytes, dict[int, Content]]:
    """The hash of all that is declared of a scene, and those of its meshes and clouds, by index.

    Args:
        message: The scene.
        look: Called again and again where that takes long.
    """
    many = {index: content_of(one, look) for index, one in enumerate(message.obstacles) if type(one) in _GEOMETRY}
    obstacles = [many[index].all if index in many else one for index, one in enumerate(message.obstacles)]
    return _hashed(msgspec.structs.asdict(message) | {"obstacles": obstacles}, look), many


def changed_content(
    before: bytes, change: Before, message: messages.Scene, look: Look = never
) -> tuple[bytes, dict[int, Content]]:
    """What a scene is known by that was made of one that is known: a hash of that, and of what changed.

    Args:
        before: What the scene before is known by.
        change: What it was before.
        message: The scene now.
        look: Called again and again where that takes long.

    Returns:
        The hash, and those of the obstacles that are others, by index.
    """
    others = [*change.moved, *range(len(message.obstacles) - change.added, len(message.obstacles))]
    fresh = {index: content_of(message.obstacles[index], look) for index in others}
    return _hashed([before, message.name, change.removed, others, [one.all for one in fresh.values()]]), fresh


_ENCODER = msgspec.msgpack.Encoder(enc_hook=np.generic.tolist)


def _hashed(declared: object, look: Look = never) -> bytes:
    """The hash of what is declared as MessagePack; `look` is called again and again while it is made."""
    hashed = hashlib.sha256()
    for some in _written(declared):
        hashed.update(some)
        look()
    return hashed.digest()


def _written(declared: object) -> Iterator[bytes]:
    """What is declared as MessagePack: a long list some at a time, and so those in a list or in a dict."""
    if isinstance(declared, list) and len(declared) > TOGETHER:
        yield _head(_ARRAY, len(declared))
        for begin in range(0, len(declared), TOGETHER):
            some = declared[begin : begin + TOGETHER]
            yield _ENCODER.encode(some)[len(_head(_ARRAY, len(some))) :]
    elif isinstance(declared, dict) and _holds_many(declared.values()):
        yield _head(_MAP, len(declared))
        for name, value in declared.items():
            yield _ENCODER.encode(name)
            yield from _written(value)
    elif isinstance(declared, list) and _holds_many(declared):
        yield _head(_ARRAY, len(declared))
        for value in declared:
            yield from _written(value)
    else:
        yield _ENCODER.encode(declared)


def _holds_many(values: Iterable[object]) -> bool:
    return any(isinstance(value, list) and len(value) > TOGETHER for value in values)


def _head(kind: tuple[int, int, int], count: int) -> bytes:
    """How a list or a dict of so many begins in MessagePack."""
    if count < 16:
        return bytes([kind[0] | count])
    return struct.pack(">BH", kind[1], count) if count < 2**16 else struct.pack(">BI", kind[2], count)
