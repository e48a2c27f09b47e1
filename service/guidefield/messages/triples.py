"""Points and triangles in messages, and fast checks of them by the standard library, which the light client has."""

from __future__ import annotations

import math
import struct
import sys
from array import array
from collections.abc import Iterable
from itertools import chain
from typing import Annotated

import msgspec

from guidefield.messages.values import LARGEST, Float32Array, Uint32Array, Vector3, require_finite

Points = list[Vector3] | Float32Array
Triangle = tuple[int, int, int]

MAX_VERTICES = 1_000_000
"""The largest number of vertices, triangles or points of an obstacle."""

Triangles = Annotated[list[Triangle], msgspec.Meta(min_length=1, max_length=MAX_VERTICES)] | Uint32Array

VALUES_PER_CHECK = 20_000
"""Points, triangles or numbers checked by one call, which holds the interpreter for a few milliseconds."""


def check_points(field: str, points: Points) -> int:
    """Check points, and return their number; raises ValueError if there are too many or none, or one isn't finite."""
    if isinstance(points, Float32Array):
        count = len(points.float32) // 12
        if points.float32[3::4].translate(None, _SMALL):
            _require_packed_finite(field, points.float32)
    else:
        count = len(points)
        for begin in range(0, count, VALUES_PER_CHECK):
            some = points[begin : begin + VALUES_PER_CHECK]
            if not math.hypot(*chain.from_iterable(some)) <= LARGEST:  # the norm of all is at least that of each
                for index, point in enumerate(some, begin):
                    require_finite(f"{field}[{index}]", point)
    if not 1 <= count <= MAX_VERTICES:
        raise ValueError(f"`{field}` must have 1 to {MAX_VERTICES} points, got {count}")
    return count


def _require_packed_finite(field: str, packed: bytes) -> None:
    """Raise ValueError for the first packed float32 that is NaN, infinite or too large."""
    for index, (value,) in enumerate(struct.iter_unpack("<f", packed)):
        if not -LARGEST <= value <= LARGEST:
            require_finite(f"{field}[{index // 3}]", (value,), index % 3)


def check_triangles(count: int, triangles: Triangles) -> None:
    """Check that triangles index existing vertices.

    Raises:
        ValueError: if an index is out of range, or packed triangles are too many or none.
    """
    if not isinstance(triangles, Uint32Array):
        for begin in range(0, len(triangles), VALUES_PER_CHECK):
            some = triangles[begin : begin + VALUES_PER_CHECK]
            if not _are_below(count, _pack_triangles(some)):  # a sixth of the time of `_require_below`
                _require_below(count, begin, some)
        return
    packed = triangles.uint32
    if not 1 <= len(packed) // 12 <= MAX_VERTICES:
        raise ValueError(f"`triangles` must have 1 to {MAX_VERTICES} triangles, got {len(packed) // 12}")
    if not _are_below(count, packed):
        flat = memoryview(packed).cast("I")
        _require_below(count, 0, zip(flat[0::3], flat[1::3], flat[2::3], strict=True))


def _require_below(count: int, first: int, triangles: Iterable[Iterable[int]]) -> None:
    for row, triangle in enumerate(triangles, first):
        for index in triangle:
            if not 0 <= index < count:
                raise ValueError(
                    f"`triangles[{row}]` names vertex {index}, but there are {count} vertices (0 to {count - 1})"
                )


_SMALL = bytes(sign | exponent for sign in (0, 0x80) for exponent in range(0x4E))
"""Highest bytes (sign and most of the exponent) of the float32 below 2^29 in magnitude, which is within `LARGEST`."""


_POSITIVE = bytes(range(0x80))
"""Highest bytes of the uint32 below 2^31."""


def _pack_triangles(triangles: Iterable[Iterable[int]]) -> bytes:
    """Pack indices of triangles as little-endian uint32; empty if one doesn't fit."""
    try:
        packed = array("I", chain.from_iterable(triangles))
    except (OverflowError, TypeError):
        return b""
    if sys.byteorder == "big":
        packed.byteswap()
    return packed.tobytes()


_BLOCK_BYTES = 2**16
"""Bytes compared as one long integer, which fits into the processor's cache."""


def _are_below(count: int, packed: bytes) -> bool:
    """Return whether there are little-endian uint32, and all of them are below a count of at most 2^31."""
    some = (packed[begin : begin + _BLOCK_BYTES] for begin in range(0, len(packed), _BLOCK_BYTES))
    addend = int.from_bytes((2**31 - count).to_bytes(4, "little") * (min(_BLOCK_BYTES, len(packed)) // 4), "little")
    return bool(packed) and all(_is_block_below(addend, each) for each in some)


def _is_block_below(addend: int, packed: bytes) -> bool:
    """Compare a block as one integer: with 2^31 - count added to each, the highest bit of those not below is set."""
    if packed[3::4].translate(None, _POSITIVE):
        return False
    moved = int.from_bytes(packed, "little") + (addend & ((1 << (8 * len(packed))) - 1))
    return not moved.to_bytes(len(packed), "little")[3::4].translate(None, _POSITIVE)
