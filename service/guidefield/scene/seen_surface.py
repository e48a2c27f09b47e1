"""What is seen of a large surface from a ball: the triangles that are nearest to some place in it."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from guidefield.geometry.cache import is_large, remembered
from guidefield.geometry.closed import used_alone
from guidefield.geometry.entries import Arrays
from guidefield.geometry.extents import box_about
from guidefield.geometry.surface_rows import NO_TRIANGLES, Triangulated, are_wide
from guidefield.kernels.cover.nearest_somewhere import nearest_somewhere
from guidefield.kernels.distance.ray_winding import ANCHOR

Whole = Callable[[], tuple[np.ndarray, np.ndarray]]
"""Makes the vertices (v, 3) [m] and triangles (t, 3) of a surface; not before they are needed."""

Anchored = Callable[[np.ndarray, np.ndarray, np.ndarray, float], np.ndarray]
"""Finds how the sides of a surface are told, of its vertices and triangles and a ball's centre and radius."""


@dataclass(frozen=True, eq=False)
class SeenSurface:
    """A part of a surface.

    Attributes:
        parts: What is seen of each of its solids, or of the thin surface, with what these triangles are neighbours of;
            all of the same vertices.
        anchors: How the sides of each solid are told, see scene/anchor.py; no numbers of one that is seen whole.
        box: Lower and upper corner about all of the surface, shape (2, 3) [m].
        whole: Makes all of the surface.
        content: What the part is known by on disk; nothing if it isn't kept there.
    """

    parts: tuple[Triangulated, ...]
    anchors: np.ndarray
    box: np.ndarray
    whole: Whole
    content: bytes

    @property
    def count(self) -> int:
        """How many triangles are seen."""
        return sum(len(triangles) for _, triangles, _ in self.parts)

    @cached_property
    def surface(self) -> tuple[np.ndarray, np.ndarray]:
        """All that is seen: vertices, each used, (v, 3) [m] and triangles (t, 3)."""
        alone = used_alone(self.parts[0][0], np.concatenate([triangles for _, triangles, _ in self.parts]))
        for array in alone:
            array.setflags(write=False)
        return alone


def seen_surface(
    whole: Whole,
    solids: Callable[[], list[np.ndarray]],
    anchored: Anchored,
    content: bytes,
    centre: np.ndarray,
    radius: float,
    most: float,
) -> SeenSurface | None:
    """Find what is seen: from everywhere in the ball each solid is as far as its seen part. Small ones are seen whole.

    Args:
        whole: Makes the surface; kept with what is found.
        solids: Makes the triangles of each solid, or all of them.
        anchored: Finds the anchor of a solid; `anchor_of`, or `no_anchor` of a thin surface.
        content: What the surface is known by; what is seen of it is kept on disk. If nothing, it is found each time.
        centre: Of the ball, shape (3,) [m].
        radius: Of the ball [m].
        most: None is returned where a larger share of its triangles is seen.
    """

    def found() -> Arrays:
        return _found(whole(), solids(), anchored, centre, radius, most)

    if not content:
        return _restored(found(), whole, b"")
    known = {"content": np.frombuffer(content, np.uint8), "ball": np.array([*centre, radius, most])}
    own = hashlib.sha256(b"".join(one.tobytes() for one in known.values())).digest()
    return _restored(remembered("seen", known, found), whole, own)


def _found(
    surface: tuple[np.ndarray, np.ndarray],
    solids: list[np.ndarray],
    anchored: Anchored,
    centre: np.ndarray,
    radius: float,
    most: float,
) -> Arrays:
    """What is seen as arrays, numbers of vertices in four bytes; of too much, nothing but that there are no parts."""
    vertices, triangles = surface
    parts = [_seen_part(vertices, solid, centre, radius) for solid in solids]
    if sum(len(seen) for seen, _ in parts) > most * len(triangles):
        return {"counts": np.empty((0, 2), np.int64)}
    alone, numbers = used_alone(vertices, np.concatenate([one for part in parts for one in part]))
    anchors = np.zeros((len(parts), ANCHOR))
    for row, solid, (_, beside) in zip(anchors, solids, parts, strict=True):
        if len(beside):
            row[:] = anchored(vertices, solid, centre, radius)
    return {
        "counts": np.array([[len(seen), len(beside)] for seen, beside in parts]),
        "anchors": anchors,
        "box": box_about(vertices),
        "vertices": alone,
        "triangles": numbers.astype(np.int32),
    }


def _restored(found: Arrays, whole: Whole, content: bytes) -> SeenSurface | None:
    counts = found["counts"]
    if not len(counts):
        return None
    numbers = np.split(found["triangles"].astype(np.int64), np.cumsum(counts.ravel())[:-1])
    parts = zip(numbers[0::2], numbers[1::2], strict=True)
    seen = tuple((found["vertices"], *part) for part in parts)
    return SeenSurface(seen, found["anchors"], found["box"], whole, content)


def _seen_part(
    vertices: np.ndarray, triangles: np.ndarray, centre: np.ndarray, radius: float
) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of a solid that are seen, and others beside them."""
    wide = are_wide(vertices, triangles)  # what has no area counts for Coal alone, and hides nothing
    chosen = np.ones(len(triangles), bool)
    if is_large(int(wide.sum())):
        chosen[wide] = seen_of(vertices, triangles[wide], centre, radius)
    if chosen.all():
        return triangles, NO_TRIANGLES
    marked = np.zeros(len(vertices), bool)
    marked[triangles[chosen]] = True
    a, b, c = triangles.T
    beside = (marked[a] | marked[b] | marked[c]) & ~chosen
    return triangles[chosen], triangles[beside]


def seen_of(vertices: np.ndarray, corners: np.ndarray, centre: np.ndarray, radius: float) -> np.ndarray:
    """Which parts of a surface or cloud are seen, shape (n,); see `nearest_somewhere`."""
    chosen = np.empty(len(corners), bool)
    vertices, corners = np.ascontiguousarray(vertices, float), np.ascontiguousarray(corners, np.int64)
    nearest_somewhere(vertices, corners, np.ascontiguousarray(centre, float), radius, chosen)
    return chosen
