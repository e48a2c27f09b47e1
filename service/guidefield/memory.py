"""Memory of this process: caches bounded in entries and bytes, with the limits of all of them, and garbage collection.

Larger limits cost memory in each worker (docs/operation.md), smaller ones time; entries are counted by `BYTES_…`.
Where the collector is paused changes time alone, and memory while the block runs.
"""

from __future__ import annotations

import contextlib
import gc
import hashlib
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator
from typing import Any, Generic, NamedTuple, TypeVar

Key = TypeVar("Key", bound=Hashable)
Value = TypeVar("Value")


class Limit(NamedTuple):
    """The largest number of entries and of bytes of a cache; one entry stays, however large it is."""

    entries: int
    bytes: int


READ_SCENES = Limit(16, 2**27)
"""Decoded scenes by hash of their encoding; in memory a scene in lists takes about four times its encoded size."""
BUILT_SCENES = Limit(16, 2**29)  # built scenes by content; a triangle or point of Coal's counts for `BYTES_PER_FACE`
RENDERED_SCENES = Limit(4, 2**29)  # built scenes of the process that renders recordings
OBSTACLES = Limit(512, 2**27)  # obstacles other than primitives at rest, by content, with sizes as in `BUILT_SCENES`
BYTES_PER_FACE = 512  # memory of a triangle, or a point of a cloud, with its tables
MESH_TREES = Limit(128, 2**29)  # trees of robots' meshes, by their vertices
PLACED_MESHES = Limit(1024, 2**27)  # tables of meshes placed in links, which a robot with a new held object reuses
TRIANGULATIONS = Limit(256, 2**27)  # triangles of Coal's meshes, by their vertices
SOLIDS = Limit(256, 2**26)  # solids of meshes, while a robot is prepared
BYTES_PER_SOLID_FACE = 512  # memory of a triangle of a solid
ROBOTS = Limit(32, 2**30)
"""Loaded robots, whose tables count in `FOUND`, by entries alone; `Catalog.origin` fails where one was evicted."""
ROBOT_LINES = Limit(1000, 2**24)  # lines about robots that were sent
ENGINES = Limit(100, 2**30)  # engines of users, which share what they load
OPEN_STORES = Limit(100, 2**20)  # open stores of users
READ_VERSIONS = Limit(32, 2**20)
"""Stored scenes of a user whose files were read, with their last versions, which most obstacles are shared by."""
FOUND = Limit(2**18, 2**30)  # memoized results for robots, scenes and obstacles, see `memo`


def content_key(*parts: Any) -> bytes:
    """Return a key of contents: SHA-256 of the size and bytes of each buffer, such as an array."""
    digest = hashlib.sha256()
    for part in parts:
        view = memoryview(part)
        digest.update(view.nbytes.to_bytes(8, "little"))
        digest.update(view if view.c_contiguous else view.tobytes())
    return digest.digest()


TRIMMED_BYTES = 2**26
"""Size of evicted entries after which free memory is returned to the system, which takes some milliseconds."""


def trim_memory() -> None:
    """Return free memory to the system, which glibc keeps between used blocks."""
    import ctypes

    with contextlib.suppress(OSError, AttributeError):  # elsewhere there is no such function
        ctypes.CDLL(None).malloc_trim(0)


class BoundedMap(Generic[Key, Value]):
    """A map that evicts its least recently used entries beyond a limit of entries and bytes."""

    def __init__(self, limit: Limit) -> None:
        self._limit = limit
        self._entries: OrderedDict[Key, tuple[Value, int]] = OrderedDict()
        self._bytes = self._freed = 0
        self._lock = threading.RLock()  # a destructor of an evicted value may use the map
        self._making: dict[Key, threading.Lock] = {}

    def __len__(self) -> int:
        return len(self._entries)

    def __contains__(self, key: Key) -> bool:
        return key in self._entries

    @property
    def size(self) -> int:
        """Size of all entries together [bytes]."""
        return self._bytes

    def get(self, key: Key) -> Value | None:
        """Return the value of a key; None if there is none."""
        with self._lock:
            entry = self._entries.get(key)
            if entry is None:
                return None
            self._entries.move_to_end(key)
            return entry[0]

    def insert(self, key: Key, value: Value, size: int = 0) -> Value:
        """Store a value of a size [bytes] unless there is one already; return the stored one."""
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

    def find(self, key: Key, make: Callable[[], Value], size_of: Callable[[Value], int]) -> Value:
        """Return the value of a key, made once, whichever threads ask for it; exceptions of `make` come through."""
        if (found := self.get(key)) is not None:
            return found
        with self._lock:
            making = self._making.setdefault(key, threading.Lock())
        try:
            with making:
                found = self.get(key)
                if found is None:
                    found = make()
                    self.insert(key, found, size_of(found))
                return found
        finally:
            with self._lock:
                self._making.pop(key, None)

    def clear(self) -> None:
        """Remove all entries."""
        for key in [*self._entries]:
            self.remove(key)

    def remove(self, key: Key) -> None:
        """Remove a key, if it is present."""
        with self._lock:
            entry = self._entries.pop(key, None)
            if entry is not None:
                self._bytes -= entry[1]
        del entry  # what goes with it may forget other keys


@contextlib.contextmanager
def pause_collector() -> Iterator[None]:
    """Pause garbage collection in this process for as long as a block runs.

    Loading a planner or reading many obstacles makes a million objects that stay, which the collector would traverse
    again and again, for a tenth of the time and more. Afterwards they belong to its oldest generation, which is
    traversed seldom. If it was off before, it stays off.
    """
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if not gc.get_freeze_count():  # else objects that somebody froze would be unfrozen
            gc.freeze()
            gc.unfreeze()
        if was_on:
            gc.enable()
