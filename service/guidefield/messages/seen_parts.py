"""A scene as it was given in Python with arrays or packed numbers: whether another one holds the same.

What is large in it is compared byte by byte, without reading a number; of the rest, which is small, what it looks like
as MessagePack.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import msgspec

from guidefield.messages.values import Look

FEWEST_BYTES = 2**14
"""Arrays and packed numbers that are shorter count as small."""

MOST_LISTED = 3000
"""So many values are looked through, in a millisecond or two; where more are listed, they are sooner read."""

TOGETHER = 2**20
"""So many bytes are compared at one go, in some tenths of a millisecond."""

_AT_ONCE = 2**16
"""So many bytes of an array are copied to be compared: they stay in the processor's cache."""

_NUMBERS = frozenset("bBhHiIlLqQfd")
"""Formats of arrays whose bytes say all there is to know."""

_TAKEN = 1
"""The code of what stands in place of what is large."""


class Parts(NamedTuple):
    """A scene as it is given.

    Attributes:
        rest: What is small in it, as MessagePack, with marks in place of what is large.
        large: What is large, in order.
    """

    rest: bytes
    large: list[bytes | memoryview]

    @classmethod
    def of(cls, given: Any) -> Parts | None:
        """Those of a dict or a message, in which arrays and packed numbers stand; None where it can't be known again.

        That is where much else is listed in it, or where nothing is large: then it is sooner read.
        """
        large, left = list[bytes | memoryview](), [MOST_LISTED]
        try:
            rest = _ENCODER.encode(_bare(given, large, left))
        except TypeError:
            return None
        return cls(rest, large) if large else None


class SeenParts:
    """What a scene held.

    Args:
        parts: The scene as it was given.
        look: Called again and again while a large one is looked at.
    """

    def __init__(self, parts: Parts, look: Look) -> None:
        self._rest, self._large = parts.rest, [_copied(one, look) for one in parts.large]

    @property
    def size(self) -> int:
        """How much is kept [bytes]."""
        return len(self._rest) + sum(map(len, self._large))

    def is_like(self, parts: Parts, look: Look) -> bool:
        """Whether a scene in the same form holds the same.

        Args:
            parts: The scene.
            look: Called again and again while it is compared.
        """
        if parts.rest != self._rest:
            return False
        return all(_are_equal(*two, look) for two in zip(parts.large, self._large, strict=True))


def _bare(value: Any, large: list[bytes | memoryview], left: list[int]) -> Any:
    """A value with a mark in place of what is large in it, which is added to a list; so many more may be listed."""
    left[0] -= 1
    if left[0] < 0:
        raise TypeError("more is listed than is looked through")
    if isinstance(value, dict):
        return {name: _bare(one, large, left) for name, one in value.items()}
    if isinstance(value, list | tuple):
        return [_bare(one, large, left) for one in value]
    if isinstance(value, msgspec.Struct):
        fields = {name: _bare(getattr(value, name), large, left) for name in value.__struct_fields__}
        return {"": type(value).__name__, **fields}
    if isinstance(value, bytes) and len(value) >= FEWEST_BYTES:
        return _taken(value, f"bytes {len(value)}", large)
    if hasattr(value, "tolist") and getattr(value, "shape", None) and (view := memoryview(value)).nbytes:
        if view.format not in _NUMBERS:
            raise TypeError(f"an array of format {view.format!r} isn't one of numbers")
        return value if view.nbytes < FEWEST_BYTES else _taken(view.cast("B"), f"{view.format} {view.shape}", large)
    return value


def _taken(one: bytes | memoryview, what: str, large: list[bytes | memoryview]) -> msgspec.msgpack.Ext:
    """The mark in place of what is large, which says all of it but its bytes."""
    large.append(one)
    return msgspec.msgpack.Ext(_TAKEN, what.encode())


def _listed(value: Any) -> Any:
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} can't be known again")


_ENCODER = msgspec.msgpack.Encoder(enc_hook=_listed)


def _copied(one: bytes | memoryview, look: Look) -> bytes:
    """What nobody changes any more."""
    if isinstance(one, bytes):
        return one
    copied = bytearray()
    for begin in range(0, len(one), TOGETHER):
        copied += one[begin : begin + TOGETHER]
        look()
    return bytes(copied)


def _are_equal(one: bytes | memoryview, known: bytes, look: Look) -> bool:
    """Whether both have the same bytes; they have as many."""
    if isinstance(one, bytes):
        return one == known
    seen = memoryview(known)
    for begin in range(0, len(one), TOGETHER):
        end = min(begin + TOGETHER, len(one))
        for at in range(begin, end, _AT_ONCE):
            if bytes(one[at : min(at + _AT_ONCE, end)]) != bytes(seen[at : min(at + _AT_ONCE, end)]):
                return False
        look()
    return True
