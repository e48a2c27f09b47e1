"""A map by content, bounded in entries and bytes; the limits of all such maps of a process stand here."""

from __future__ import annotations

import contextlib
import threading
from collections import OrderedDict
from collections.abc import Hashable
from typing import Generic, NamedTuple, TypeVar

Key = TypeVar("Key", bound=Hashable)
Value = TypeVar("Value")


class Limit(NamedTuple):
    """Most entries of a map, and most bytes of all of them together; one entry stays, however large it is."""

    entries: int
    bytes: int


READ_SCENES = Limit(16, 2**27)
"""Scenes of requests, by the bytes that they were sent as; in memory a scene in lists takes about four times these."""

BUILT_SCENES = Limit(16, 2**29)
"""Scenes that are built, by content; a triangle or point that Coal judges counts for `BYTES_PER_FACE`."""

RENDERED_SCENES = Limit(4, 2**29)
"""The same of the process that renders recordings."""

OBSTACLES = Limit(512, 2**27)
"""Obstacles that are no primitives at rest, by content, counted as in scenes."""

BYTES_PER_FACE = 512
"""Memory that a triangle, or a point of a cloud, takes with the tables of it."""

MESH_TREES = Limit(128, 2**29)
"""Trees of robots' meshes, by their vertices."""

PLACED_MESHES = Limit(1024, 2**27)
"""Tables of meshes where they stand in their links: a robot that holds something new has most of them as before."""

TRIANGULATIONS = Limit(256, 2**27)
"""Triangles of Coal's meshes, by their vertices."""

FOUND = Limit(2**18, 2**30)
"""Tables and whatever else functions find once for robots, scenes and obstacles, see `memo`."""


TRIMMED_BYTES = 2**26
"""Memory is given back whenever entries of so many bytes were forgotten for others, which takes some milliseconds."""


def trim_memory() -> None:
    """Give free memory back to the system: glibc keeps what is between blocks in use."""
    import ctypes

    with contextlib.suppress(OSError, AttributeError):  # elsewhere there is no such function
        ctypes.CDLL(None).malloc_trim(0)


class BoundedMap(Generic[Key, Value]):
    """A map that forgets the entries used least recently once it has too many, or they are too large.

    Args:
        limit: What it keeps at most.
    """

    def __init__(self, limit: Limit) -> None:
        self._limit = limit
        self._entries: OrderedDict[Key, tuple[Value, int]] = OrderedDict()
        self._bytes = self._freed = 0
        self._lock = threading.RLock()  # what is forgotten may ask for something as it goes

    def __len__(self) -> int:
        return len(self._entries)

    def __contains__(self, key: Key) -> bool:
        return key in self._entries

    @property
    def size(self) -> int:
        """Size of all entries together [bytes]."""
        return self._bytes

    def get(self, key: Key) -> Value | None:
        """Return what is kept for a key; None if nothing is."""
        with self._lock:
            entry = self._entries.get(key)
            if entry is None:
                return None
            self._entries.move_to_end(key)
            return entry[0]

    def put(self, key: Key, value: Value, size: int = 0) -> Value:
        """Keep a value of a size [bytes], unless another one was sooner; return the one that is kept."""
        with self._lock:
            known = self.get(key)
            if known is not None:
                return known
            self._entries[key] = value, size
            self._bytes += size
            before = self._bytes
            while len(self._entries) > self._limit.entries or (
                self._bytes > self._limit.bytes and len(self._entries) > 1
            ):
                self.remove(next(iter(self._entries)))
            self._freed += before - self._bytes
            if self._freed > TRIMMED_BYTES:
                self._freed = 0
                trim_memory()
            return value

    def clear(self) -> None:
        """Forget all entries."""
        for key in [*self._entries]:
            self.remove(key)

    def remove(self, key: Key) -> None:
        """Forget what is kept for a key, if anything is."""
        with self._lock:
            entry = self._entries.pop(key, None)
            if entry is not None:
                self._bytes -= entry[1]
        del entry  # what goes with it may forget other keys
