"""Read the numbers of declared obstacles, listed or packed, and hash obstacles and scenes.

Built obstacles, scenes and files on disk are found again by these hashes, in memory and on disk. A kind of obstacle
that may have very many numbers belongs in `_GEOMETRY` (and in `_parts`), so that they are hashed only once.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import msgspec
import numpy as np

from guidefield.memory import content_key
from guidefield.messages import scene as messages
from guidefield.messages.scene import Points, Triangles
from guidefield.messages.scene_changes import Derivation
from guidefield.messages.values import Float32Array, Uint32Array


def points_in(points: Points) -> np.ndarray:
    """Return the points of a message, shape (n, 3) [m]."""
    if isinstance(points, Float32Array):
        return np.frombuffer(points.float32, "<f4").reshape(-1, 3).astype(float)
    return _triples(points, float)


def corners_in(triangles: Triangles) -> np.ndarray:
    """Return the indices of triangles' corners in a message, shape (t, 3)."""
    if isinstance(triangles, Uint32Array):
        return np.frombuffer(triangles.uint32, "<u4").reshape(-1, 3).astype(np.int64)
    return _triples(triangles, np.int64)


def _triples(listed: list[Any], kind: type) -> np.ndarray:
    flat = itertools.chain.from_iterable(listed)  # NumPy reads it in a third of the time
    return np.fromiter(flat, kind, 3 * len(listed)).reshape(-1, 3)


def count_of(some: Points | Triangles) -> int:
    """Return the number of points or triangles in a message."""
    match some:
        case Float32Array():
            return len(some.float32) // 12
        case Uint32Array():
            return len(some.uint32) // 12
    return len(some)


def are_many(declared: Sequence[messages.Obstacle | messages.GuidePlane], most: int) -> bool:
    """Return whether obstacles or guide planes with their corners, triangles, points and places are at least `most`."""
    return len(declared) >= most or len(declared) + sum(map(_parts, declared)) >= most


def _parts(declared: messages.Obstacle | messages.GuidePlane) -> int:
    """Count the corners, triangles, points and places of a declaration; 0 for a primitive at rest."""
    match declared:
        case messages.GuidePlane():
            return len(declared.vertices)
        case messages.Polygon():
            parts = len(declared.vertices)
        case messages.Mesh():
            parts = count_of(declared.triangles) + count_of(declared.vertices)
        case messages.PointCloud():
            parts = count_of(declared.points)
        case _:
            parts = 0
    return parts if declared.trajectory is None else parts + len(declared.trajectory.times)


class Content(NamedTuple):
    """Hashes of a declared obstacle: of all, and of its points and triangles alone if its kind has them."""

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
        return Content(_hash(message))
    geometry = _hash([getattr(message, field) for field in fields])
    rest = {name: value for name, value in msgspec.structs.asdict(message).items() if name not in fields}
    return Content(_hash([type(message).__name__, rest, geometry]), geometry)


def scene_content(message: messages.Scene) -> tuple[bytes, dict[int, Content]]:
    """Hash all that is declared of a scene; return also the hashes of its meshes and clouds, by index."""
    many = {index: content_of(one) for index, one in enumerate(message.obstacles) if type(one) in _GEOMETRY}
    obstacles = [many[index].all if index in many else one for index, one in enumerate(message.obstacles)]
    return _hash(msgspec.structs.asdict(message) | {"obstacles": obstacles}), many


def change_content(before: bytes, change: Derivation, message: messages.Scene) -> tuple[bytes, dict[int, Content]]:
    """Hash a changed scene from the hash before and the change; return also hashes of new obstacles, by index."""
    others = [*change.moved, *range(len(message.obstacles) - change.added, len(message.obstacles))]
    fresh = {index: content_of(message.obstacles[index]) for index in others}
    return _hash([before, message.name, change.removed, others, [one.all for one in fresh.values()]]), fresh


_ENCODER = msgspec.msgpack.Encoder(enc_hook=np.generic.tolist)


def _hash(declared: object) -> bytes:
    return content_key(_ENCODER.encode(declared))
