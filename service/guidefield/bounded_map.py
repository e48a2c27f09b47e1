"""A map by content, bounded in entries and bytes; the limits of all such maps of a process stand here."""

from __future__ import annotations

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


class BoundedMap(Generic[Key, Value]):
    """A map that forgets the entries used least recently once it has too many, or they are too large.

    Args:
        limit: What it keeps at most.
    """

    def __init__(self, limit: Limit) -> None:
        self._limit = limit
        self._entries: OrderedDict[Key, tuple[Value, int]] = OrderedDict()
        self._bytes = 0
        self._lock = threading.RLock()  # what is forgotten may ask for something as it goes

    def __len__(self) -> int:
        return len(self._entries)

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
            while len(self._entries) > self._limit.entries or (
                self._bytes > self._limit.bytes and len(self._entries) > 1
            ):
                self._bytes -= self._entries.popitem(last=False)[1][1]
            return value
