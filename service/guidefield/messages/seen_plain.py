"""A scene as it was given in Python in dicts and lists: whether another one says the same."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import msgspec

from guidefield.messages.values import Look
from guidefield.messages.written import written

LOOKED_AFTER = 2**20
"""So many bytes are written in a millisecond or two."""


class SeenPlain:
    """What a scene said, as MessagePack: to write it takes a tenth of the time that it takes to read it.

    Args:
        scene: The scene.
        look: Called again and again while it is written.

    Raises:
        TypeError: if there is anything in it that MessagePack has no form for, such as an array.
    """

    def __init__(self, scene: dict[str, Any], look: Look) -> None:
        made = bytearray()
        for some in _plain(scene, look):
            made += some
        self._said = bytes(made)

    @property
    def size(self) -> int:
        """How much is kept [bytes]."""
        return len(self._said)

    def is_like(self, scene: dict[str, Any], look: Look) -> bool:
        """Whether a scene says the same, in the same order.

        Args:
            scene: The scene.
            look: Called again and again while it is compared.
        """
        at = 0
        try:
            for some in _plain(scene, look):
                if not self._said.startswith(some, at):
                    return False
                at += len(some)
        except TypeError:
            return False
        return at == len(self._said)


def _plain(scene: dict[str, Any], look: Look) -> Iterator[bytes]:
    left = LOOKED_AFTER
    try:
        for some in written(scene, _ENCODER.encode):
            yield some
            left -= len(some)
            if left <= 0:
                look()
                left = LOOKED_AFTER
    except (ValueError, OverflowError, RecursionError) as error:  # what is no text, or too large, or too deep
        raise TypeError(str(error)) from None


def _numbers(value: Any) -> Any:
    if hasattr(value, "tolist") and not getattr(value, "shape", None):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} is nothing plain")


_ENCODER = msgspec.msgpack.Encoder(enc_hook=_numbers)
