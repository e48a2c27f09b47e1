"""Messages inside a recording: MessagePack, compressed; a third of their JSON, and exact to the last bit."""

from __future__ import annotations

import zlib
from typing import TypeVar

import msgspec
import numpy as np

from guidefield.messages import codec
from guidefield.messages.requests import MotionRequest
from guidefield.messages.scene import Scene

MESSAGE_COMPONENT = "message"
"""The component of a document's entity that holds the message itself."""
LEVEL = 1
"""Of compression: harder ones take three times as long and save nothing on numbers."""
LARGEST_MESSAGE = 1 << 28
"""Bytes of a message, unpacked, that are read from a recording at most."""

_M = TypeVar("_M", bound=msgspec.Struct)


SCENE = "/documents/scene"
"""The entity that holds the message of a large scene; the request's own is without it then."""
LARGE_BYTES = 32 * 1024
"""From this size on [bytes of MessagePack] a scene has an entity, and in stores a file, of its own."""


def encoded(message: msgspec.Struct) -> bytes:
    """Return a message as MessagePack."""
    return codec.encode(message, codec.Encoding.MSGPACK)


def packed(message: msgspec.Struct) -> np.ndarray:
    """A message as bytes, shape (n,), uint8."""
    return np.frombuffer(zlib.compress(encoded(message), LEVEL), np.uint8)


def large_scene(request: MotionRequest) -> Scene | None:
    """Return the scene that a request holds, if it is large."""
    scene = request.scene
    return scene if isinstance(scene, Scene) and len(encoded(scene)) >= LARGE_BYTES else None


def unpacked(content: bytes, kind: type[_M]) -> _M:
    """The message that `packed` packed.

    Raises:
        ValueError: if it is no message of that kind.
    """
    inflate = zlib.decompressobj()
    try:
        return msgspec.msgpack.decode(inflate.decompress(content, LARGEST_MESSAGE), type=kind)
    except (zlib.error, msgspec.DecodeError) as error:
        raise ValueError(f"what should be a {kind.__name__} is none: {error}") from error
