"""What is long as MessagePack, some at a time: the same bytes as at one go."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Iterator

TOGETHER = 1_000
"""So many triples or obstacles are written in a millisecond or two."""

_ARRAY, _MAP = (0x90, 0xDC, 0xDD), (0x80, 0xDE, 0xDF)
"""First bytes of lists and dicts in MessagePack: of fewer than 16, the number in it, of fewer than 2^16, of more."""


def written(declared: object, encode: Callable[[object], bytes]) -> Iterator[bytes]:
    """What is declared: a long list some at a time, and so those in a list or in a dict.

    Args:
        declared: Plain data.
        encode: Writes some of it.
    """
    if isinstance(declared, list) and len(declared) > TOGETHER:
        yield _head(_ARRAY, len(declared))
        for begin in range(0, len(declared), TOGETHER):
            some = declared[begin : begin + TOGETHER]
            if isinstance(some[0], dict) and _are_long(some):
                for value in some:
                    yield from written(value, encode)
            else:
                yield encode(some)[len(_head(_ARRAY, len(some))) :]
    elif isinstance(declared, dict) and _are_long(declared.values()):
        yield _head(_MAP, len(declared))
        for name, value in declared.items():
            yield encode(name)
            yield from written(value, encode)
    elif isinstance(declared, list) and _are_long(declared):
        yield _head(_ARRAY, len(declared))
        for value in declared:
            yield from written(value, encode)
    else:
        yield encode(declared)


def _are_long(values: Iterable[object]) -> bool:
    return any(map(_is_long, values))


def _is_long(value: object) -> bool:
    """Whether a list is long, or one in it or in a dict, in a field that may hold a long one."""
    if isinstance(value, list):
        return len(value) > TOGETHER or (bool(value) and isinstance(value[0], dict) and _are_long(value))
    if isinstance(value, dict):
        return not _LONG.isdisjoint(value) and _are_long(value[name] for name in _LONG & value.keys())
    return False


_LONG = frozenset({"obstacles", "guide_planes", "vertices", "triangles", "points", "trajectory", "times", "placements"})
"""Fields that may hold long lists: of thousands of obstacles most have none."""


def _head(kind: tuple[int, int, int], count: int) -> bytes:
    """How a list or a dict of so many begins in MessagePack."""
    if count < 16:
        return bytes([kind[0] | count])
    return struct.pack(">BH", kind[1], count) if count < 2**16 else struct.pack(">BI", kind[2], count)
