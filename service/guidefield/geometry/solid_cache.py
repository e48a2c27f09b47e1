"""A cache of the solids of meshes: the hull, the cover and the convex parts of a mesh are found from the same one."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Callable
from dataclasses import dataclass, field

from guidefield.geometry.coarse import coarse_solid
from guidefield.geometry.nested import filled
from guidefield.geometry.solid import Solid, solid
from guidefield.geometry.surfaces import Floats, Integers

MAX_TRIANGLES = 2**17
"""The cache holds the solids used last, of this many triangles together: about 400 bytes each."""


def solid_of_mesh(vertices: Floats, triangles: Integers, widest_gap: float) -> Solid:
    """Return `solid` of these arguments, from the cache if it is there."""
    return _CACHE.find((_digest(vertices, triangles), widest_gap), lambda: _solid(vertices, triangles, widest_gap))


def near_solid_of_mesh(vertices: Floats, triangles: Integers, widest_gap: float) -> Solid:
    """Return the `coarse_solid` of a mesh, from the cache if it is there; `solid_of_mesh` if it has none."""

    def build() -> Solid:
        return coarse_solid(vertices, triangles) or solid_of_mesh(vertices, triangles, widest_gap)

    return _CACHE.find((_digest(vertices, triangles), widest_gap, "near"), build)


def filled_solid_of_mesh(vertices: Floats, triangles: Integers, widest_gap: float) -> Solid:
    """Return the `filled` near solid of these arguments, from the cache if it is there."""

    def fill() -> Solid:
        return filled(near_solid_of_mesh(vertices, triangles, widest_gap))

    return _CACHE.find((_digest(vertices, triangles), widest_gap, "filled"), fill)


def clear_solids() -> None:
    """Empty the cache, when all that needs the solids of a robot has been found."""
    _CACHE.clear()


def _solid(vertices: Floats, triangles: Integers, widest_gap: float) -> Solid:
    """Build a solid; one that is closed without its gaps is the same with them."""
    if widest_gap > 0.0 and (closed := _CACHE.peek((_digest(vertices, triangles), 0.0))) is not None and closed.closed:
        return closed
    return solid(vertices, triangles, widest_gap)


def _digest(vertices: Floats, triangles: Integers) -> bytes:
    digest = hashlib.sha256(vertices.tobytes())
    digest.update(triangles.tobytes())
    return digest.digest()


@dataclass(eq=False)
class _Entry:
    """One solid, and the lock of the thread that builds it."""

    building: threading.Lock = field(default_factory=threading.Lock)
    solid: Solid | None = None


class SolidCache:
    """Solids by key, those used last.

    Args:
        most: Number of triangles of all solids together; the one used last stays, however many it has.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._entries: dict[tuple[object, ...], _Entry] = {}
        self._changing = threading.Lock()

    def find(self, key: tuple[object, ...], build: Callable[[], Solid]) -> Solid:
        """Return a solid; it is built once, whichever threads ask for it. What `build` raises comes through."""
        with self._changing:
            entry = self._entries.pop(key, None) or _Entry()
            self._entries[key] = entry  # the last one asked for stands last
        try:
            with entry.building:
                if entry.solid is None:
                    entry.solid = build()
                return entry.solid
        finally:
            with self._changing:
                self._drop(key, entry)

    def peek(self, key: tuple[object, ...]) -> Solid | None:
        """Return a solid if it is there."""
        with self._changing:
            entry = self._entries.get(key)
            return None if entry is None else entry.solid

    def clear(self) -> None:
        """Forget all solids."""
        with self._changing:
            self._entries.clear()

    def _drop(self, key: tuple[object, ...], last: _Entry) -> None:
        """Drop an entry that was not built, and the oldest that are too many."""
        if last.solid is None:
            self._entries.pop(key, None)
        sizes = {key: len(entry.solid.owners) for key, entry in self._entries.items() if entry.solid is not None}
        total = sum(sizes.values())
        for oldest in list(sizes)[:-1]:
            if total <= self._most:
                break
            total -= sizes[oldest]
            del self._entries[oldest]


_CACHE = SolidCache(MAX_TRIANGLES)
