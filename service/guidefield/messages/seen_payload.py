"""A scene as it stands in a payload: whether another one is written in the same bytes."""

from __future__ import annotations

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
        try:
            found: dict[str, msgspec.Raw] = _DECODERS[self.encoding].decode(self.data)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
            return {}
        return found

    @property
    def scene(self) -> msgspec.Raw:
        """Where its scene is written; empty where it has none."""
        return self.fields.get("scene", _NONE)

    @property
    def has_type(self) -> bool:
        """Whether it says what it is."""
        return self.fields.get("type", _NULL) != _NULL


_NONE, _NULL = msgspec.Raw(b""), msgspec.Raw(b"null")

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
        self._payload = given

    @property
    def size(self) -> int:
        """How much is kept [bytes]."""
        return len(self._payload.data)

    def is_like(self, given: Payload, look: Look) -> bool:
        """Whether the scene in another payload is written in the same bytes."""
        look()
        return given.encoding is self._payload.encoding and given.scene == self._payload.scene != _NONE
