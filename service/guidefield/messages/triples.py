"""Points and triangles as they are declared: how many there may be, and what is sound."""

from __future__ import annotations

import functools
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
"""Most vertices, triangles or points that one obstacle may have."""

Triangles = Annotated[list[Triangle], msgspec.Meta(min_length=1, max_length=MAX_VERTICES)] | Uint32Array

VALUES_PER_CHECK = 20_000
"""So many points or triangles are read or checked at one go, in a few milliseconds."""


def check_points(field: str, points: Points) -> int:
    """The number of points.

    Args:
        field: What they are called.
        points: As they are declared.

    Raises:
        ValueError: if there are too many or none, or one isn't finite.
    """
    if isinstance(points, Float32Array):
        count = len(points.float32) // 12
        if points.float32[3::4].translate(None, _SMALL):
            _require_packed_finite(field, points.float32)
    else:
        count = len(points)
        for begin in range(0, count, VALUES_PER_CHECK):
            some = points[begin : begin + VALUES_PER_CHECK]
            if not math.hypot(*chain.from_iterable(some)) <= LARGEST:  # the norm of all is more than that of each
                for index, point in enumerate(some, begin):
                    require_finite(f"{field}[{index}]", point)
    if not 1 <= count <= MAX_VERTICES:
        raise ValueError(f"`{field}` must have 1 to {MAX_VERTICES} points, got {count}")
    return count


def _require_packed_finite(field: str, packed: bytes) -> None:
    """ValueError for the first of some packed float32 that is NaN, infinite or too large."""
    for index, (value,) in enumerate(struct.iter_unpack("<f", packed)):
        if not -LARGEST <= value <= LARGEST:
            require_finite(f"{field}[{index // 3}]", (value,), index % 3)


def check_triangles(count: int, triangles: Triangles) -> None:
    """Check which vertices triangles name.

    Args:
        count: How many vertices there are.
        triangles: As they are declared.

    Raises:
        ValueError: if one names a vertex that there isn't, or there are too many or none that are packed.
    """
    if not isinstance(triangles, Uint32Array):
        for begin in range(0, len(triangles), VALUES_PER_CHECK):
            some = triangles[begin : begin + VALUES_PER_CHECK]
            if not _all_below(count, _packed(some)):  # of a million triangles this is found in a sixth of the time
                _require_below(count, begin, some)
        return
    packed = triangles.uint32
    if not 1 <= len(packed) // 12 <= MAX_VERTICES:
        raise ValueError(f"`triangles` must have 1 to {MAX_VERTICES} triangles, got {len(packed) // 12}")
    if not _all_below(count, packed):
        flat = memoryview(packed).cast("I")
        _require_below(count, 0, zip(flat[0::3], flat[1::3], flat[2::3], strict=True))


def _require_below(count: int, first: int, triangles: Iterable[Iterable[int]]) -> None:
    """ValueError where one of some triangles, of which the first has a number, names a vertex that there isn't."""
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


def _packed(triangles: Iterable[Iterable[int]]) -> bytes:
    """Numbers of triangles as little-endian uint32; empty where one can't be."""
    try:
        packed = array("I", chain.from_iterable(triangles))
    except (OverflowError, TypeError):
        return b""
    if sys.byteorder == "big":
        packed.byteswap()
    return packed.tobytes()


_SOME = 2**16
"""So many bytes are looked at together: long integers of that length stay in the processor's cache."""


def _all_below(count: int, packed: bytes) -> bool:
    """Return whether there are any, and all of some little-endian uint32 are below a count of at most 2^31."""
    some = (packed[begin : begin + _SOME] for begin in range(0, len(packed), _SOME))
    return bool(packed) and all(_some_below(count, each) for each in some)


def _some_below(count: int, packed: bytes) -> bool:
    """The same of some, all at once, as one long integer.

    With 2^31 - count added to each, the highest bit is set of those that aren't.
    """
    if packed[3::4].translate(None, _POSITIVE):
        return False
    moved = int.from_bytes(packed, "little") + _added(count, len(packed))
    return not moved.to_bytes(len(packed), "little")[3::4].translate(None, _POSITIVE)


@functools.lru_cache(maxsize=4)
def _added(count: int, size: int) -> int:
    """2^31 - count in each of the uint32 of so many bytes, as one long integer."""
    return int.from_bytes((2**31 - count).to_bytes(4, "little") * (size // 4), "little")
