"""A scene as it stands in a payload: whether another one is written in the same bytes."""

from __future__ import annotations

import uuid
from functools import cached_property
from typing import Any

import msgspec

from guidefield.messages.codec import Encoding, require_readable
from guidefield.messages.values import Look


class Payload:
    """A message as it came, looked through once.

    Args:
        data: The payload.
        encoding: How it is written.
    """

    def __init__(self, data: bytes, encoding: Encoding) -> None:
        self.data, self.encoding = data, encoding

    @cached_property
    def fields(self) -> dict[str, msgspec.Raw]:
        """Where each field of it is written; none where it is no message.

        Raises:
            RequestTooLarge: if it is too long to be looked at.
        """
        require_readable(len(self.data))
        return self._read(self.data)

    def _read(self, data: bytes) -> dict[str, msgspec.Raw]:
        try:
            found: dict[str, msgspec.Raw] = _DECODERS[self.encoding].decode(data)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
            return {}
        return found

    def has_scene(self, scene: msgspec.Raw) -> bool:
        """Whether its scene is written in certain bytes.

        Where these stand somewhere in it, all else is read with a mark in their place, which nobody can guess: where
        that turns out to be the scene, they are, and needn't be looked through.

        Raises:
            RequestTooLarge: if it is too long to be looked at.
        """
        require_readable(len(self.data))
        written = memoryview(scene)
        at = self.data.find(bytes(written[:_BEGIN])) if type(self.data) is bytes else -1
        if at >= 0 and self.data.startswith(written, at):
            mark = _MARKS[self.encoding]
            others = self._read(self.data[:at] + bytes(mark) + self.data[at + len(written) :])
            if others.get("scene") == mark:
                self.__dict__["fields"] = others | {"scene": scene}
                return True
        return self.scene == scene

    @property
    def scene(self) -> msgspec.Raw:
        """Where its scene is written; empty where it has none."""
        return self.fields.get("scene", _NONE)

    @property
    def has_type(self) -> bool:
        """Whether it says what it is."""
        return self.fields.get("type", _NULL) != _NULL


_NONE, _NULL = msgspec.Raw(b""), msgspec.Raw(b"null")

_BEGIN = 256
"""So many bytes of a scene are looked for."""

_MARK = uuid.uuid4().hex

_MARKS = {
    Encoding.JSON: msgspec.Raw(msgspec.json.encode(_MARK)),
    Encoding.MSGPACK: msgspec.Raw(msgspec.msgpack.encode(_MARK)),
}
"""What stands in the place of a scene."""

_DECODERS: dict[Encoding, Any] = {
    Encoding.JSON: msgspec.json.Decoder(dict[str, msgspec.Raw]),
    Encoding.MSGPACK: msgspec.msgpack.Decoder(dict[str, msgspec.Raw]),
}


class SeenPayload:
    """What a scene in a payload was written in; the payload is kept.

    Args:
        given: The payload.
        look: As for what is seen in other forms; bytes are compared in some milliseconds.
    """

    def __init__(self, given: Payload, look: Look) -> None:
        look()
        self._encoding, self._size = given.encoding, len(given.data)
        self._scene = given.scene

    @property
    def size(self) -> int:
        """How much is kept [bytes]."""
        return self._size

    def is_like(self, given: Payload, look: Look) -> bool:
        """Whether the scene in another payload is written in the same bytes."""
        look()
        return given.encoding is self._encoding and self._scene != _NONE and given.has_scene(self._scene)
