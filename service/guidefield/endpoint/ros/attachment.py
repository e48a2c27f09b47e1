"""What rmw_zenoh attaches to every sample and query: who sent it, when, and its number."""

from __future__ import annotations

import struct
import time
from dataclasses import dataclass

_LAYOUT = struct.Struct("<qqB16s")
"""Sequence number, time since 1970 [ns], length of the identifier, and the identifier."""
_ID_BYTES = 16


@dataclass(frozen=True)
class Attachment:
    """Who sent something, and its number.

    Attributes:
        number: Counted by the sender, from 1.
        sender: Its identifier, 16 bytes.
    """

    number: int
    sender: bytes

    @classmethod
    def read(cls, payload: bytes) -> Attachment | None:
        """What bytes say; None if they are no attachment."""
        if len(payload) != _LAYOUT.size:
            return None
        number, _, length, sender = _LAYOUT.unpack(payload)
        return cls(number, sender) if length == _ID_BYTES else None

    def write(self) -> bytes:
        """The bytes, with the present time."""
        return _LAYOUT.pack(self.number, time.time_ns(), _ID_BYTES, self.sender)
