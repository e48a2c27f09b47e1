"""Crop a large surface to the triangles that may be nearest to some place in a ball.

Signed distances stay exact by the neighbours of the kept triangles and, for a solid, an anchor: a place from which the
sides are known (kernels/distance/ray_winding.py). Kept parts are cached on disk by the surface's hash.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from guidefield.geometry.cache import Arrays, find_or_compute, is_large
from guidefield.geometry.closed import boxes_about, drop_unused
from guidefield.geometry.distance_bodies import NO_TRIANGLES, Triangulated, are_wide
from guidefield.geometry.surfaces import box_about
from guidefield.kernels.cover.crop_to_ball import crop_to_ball, distance_to_triangles
from guidefield.kernels.cover.winding import winding_by_angles
from guidefield.kernels.distance.ray_winding import ANCHOR, BALL, PLACE, REACH, ROOM, TURNS
from guidefield.memory import content_key

Whole = Callable[[], tuple[np.ndarray, np.ndarray]]
"""Makes the vertices (v, 3) [m] and triangles (t, 3) of a surface; not before they are needed."""

_GOOD_ANCHOR = 0.05  # the ball's centre serves as anchor if so large a share of its radius about it is free. Unrecorded
ROUNDING = 1e-9  # share by which the ball is larger when solids that come into it are kept: it may grow, not shrink
_WINDING_TOLERANCE = 0.01  # a place is an anchor if its winding number is within this of a whole one


@dataclass(frozen=True, eq=False)
class CroppedSurface:
    """A part of a surface."""

    # the kept triangles of each of its solids that is near, or of the thin surface, with their neighbours; all of the
    # same vertices
    parts: tuple[Triangulated, ...]
    anchors: np.ndarray  # rows of `ray_winding.ANCHOR` columns for each solid; zeros of one that is kept whole
    box: np.ndarray  # lower and upper corner about all of the surface, shape (2, 3) [m]
    whole: Whole  # make all of the surface, and the triangles of each of its solids
    solids: Callable[[], list[np.ndarray]]
    content: bytes  # the key of the part on disk; empty if it isn't kept there

    @property
    def count(self) -> int:
        """Number of kept triangles."""
        return sum(len(triangles) for _, triangles, _ in self.parts)

    @cached_property
    def surface(self) -> tuple[np.ndarray, np.ndarray]:
        """Vertices, each used, (v, 3) [m] and triangles (t, 3)."""
        alone = drop_unused(self.parts[0][0], np.concatenate([triangles for _, triangles, _ in self.parts]))
        for array in alone:
            array.setflags(write=False)
        return alone


def crop_surface(
    whole: Whole,
    solids: Callable[[], list[np.ndarray]],
    content: bytes,
    centre: np.ndarray,
    radius: float,
    *,
    solid: bool,
    most: float,
) -> CroppedSurface | None:
    """Crop a surface to a ball: from everywhere in the ball the part is as far as all of it. Small solids stay or go.

    `whole` makes the surface, `solids` the triangles of its solids, or all of a thin one; both only if needed. With the
    surface's hash `content` the part is kept on disk. None if a larger share than `most` of its triangles is left.
    """

    def find() -> Arrays:
        return _find_parts(whole(), solids(), solid, centre, radius, most)

    if not content:
        return _restore(find(), whole, solids, b"")
    known = {"content": np.frombuffer(content, np.uint8), "ball": np.array([*centre, radius, most])}
    own = content_key(*known.values())
    return _restore(find_or_compute("seen", known, find), whole, solids, own)


def _find_parts(
    surface: tuple[np.ndarray, np.ndarray],
    solids: list[np.ndarray],
    solid: bool,
    centre: np.ndarray,
    radius: float,
    most: float,
) -> Arrays:
    """Return the part as arrays, triangles as int32; if too much is left, empty `counts` alone."""
    vertices, triangles = surface
    if len(solids) > 1:
        solids = _near_solids(vertices, solids, centre, radius)
    parts = [_part(vertices, one, centre, radius) for one in solids]
    if sum(len(kept) for kept, _ in parts) > most * len(triangles):
        return {"counts": np.empty((0, 2), np.int64)}
    alone, numbers = drop_unused(vertices, np.concatenate([one for part in parts for one in part]))
    anchors = np.zeros((len(parts), ANCHOR))
    for row, one, (_, beside) in zip(anchors, solids, parts, strict=True):
        if solid and len(beside):
            row[:] = anchor_of(vertices, one, centre, radius)
    return {
        "counts": np.array([[len(kept), len(beside)] for kept, beside in parts]),
        "anchors": anchors,
        "box": box_about(vertices),
        "vertices": alone,
        "triangles": numbers.astype(np.int32),
    }


def _near_solids(vertices: np.ndarray, solids: list[np.ndarray], centre: np.ndarray, radius: float) -> list[np.ndarray]:
    """Return the solids that may be nearest to some place in a ball, or around one: whose boxes come into the ball."""
    triangles = np.concatenate(solids)
    ends = np.cumsum([len(one) for one in solids])
    starts = np.concatenate([[0], ends[:-1]])
    near = np.logical_or.reduceat(nearest_parts(vertices, triangles, centre, radius), starts)
    low, high = boxes_about(vertices, solids).swapaxes(0, 1)
    apart = np.linalg.norm(np.maximum(np.maximum(low - centre, centre - high), 0.0), axis=1)
    near |= apart <= radius * (1.0 + ROUNDING)
    return [one for one, kept in zip(solids, near.tolist(), strict=True) if kept]


def _restore(
    found: Arrays, whole: Whole, solids: Callable[[], list[np.ndarray]], content: bytes
) -> CroppedSurface | None:
    counts = found["counts"]
    if not len(counts):
        return None
    numbers = np.split(found["triangles"].astype(np.int64), np.cumsum(counts.ravel())[:-1])
    parts = zip(numbers[0::2], numbers[1::2], strict=True)
    kept = tuple((found["vertices"], *part) for part in parts)
    return CroppedSurface(kept, found["anchors"], found["box"], whole, solids, content)


def _part(
    vertices: np.ndarray, triangles: np.ndarray, centre: np.ndarray, radius: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the triangles of a solid that are kept, and their neighbours."""
    wide = are_wide(vertices, triangles)  # what has no area counts for Coal alone, and hides nothing
    chosen = np.ones(len(triangles), bool)
    if is_large(int(wide.sum())):
        chosen[wide] = nearest_parts(vertices, triangles[wide], centre, radius)
    if chosen.all():
        return triangles, NO_TRIANGLES
    marked = np.zeros(len(vertices), bool)
    marked[triangles[chosen]] = True
    a, b, c = triangles.T
    beside = (marked[a] | marked[b] | marked[c]) & ~chosen
    return triangles[chosen], triangles[beside]


def nearest_parts(vertices: np.ndarray, corners: np.ndarray, centre: np.ndarray, radius: float) -> np.ndarray:
    """Choose triangles or points that may be nearest to some place in a ball, shape (n,); see `crop_to_ball`."""
    chosen = np.empty(len(corners), bool)
    vertices, corners = np.ascontiguousarray(vertices, float), np.ascontiguousarray(corners, np.int64)
    crop_to_ball(vertices, corners, np.ascontiguousarray(centre, float), radius, chosen)
    return chosen


def anchor_of(vertices: np.ndarray, triangles: np.ndarray, centre: np.ndarray, radius: float) -> np.ndarray:
    """Return a place from which the sides of a solid are known within a ball, see `ray_winding.surely_outside_seen`.

    It is the ball's centre (3,), or the place around it about which most is free of the surface of vertices (v, 3) and
    triangles (t, 3) [m]. Shape (ANCHOR,); with no room where nothing is known.
    """
    wide = triangles[are_wide(vertices, triangles)]
    surface, row = (np.ascontiguousarray(vertices, float), np.ascontiguousarray(wide, np.int64)), np.zeros(ANCHOR)
    row[BALL:REACH], row[REACH] = centre, radius
    for off in np.vstack([np.zeros(3), 0.5 * np.eye(3), -0.5 * np.eye(3)]):
        x, y, z = (float(one) for one in centre + radius * off)
        free = min(distance_to_triangles(x, y, z, *surface), radius * (1.0 - float(np.linalg.norm(off))))
        if 0.5 * free > row[ROOM]:
            row[PLACE:ROOM], row[ROOM] = (x, y, z), 0.5 * free
        if row[ROOM] >= 0.5 * _GOOD_ANCHOR * radius:
            break
    turns = winding_by_angles(row[PLACE], row[PLACE + 1], row[PLACE + 2], *surface) if row[ROOM] > 0.0 else 0.0
    row[TURNS] = round(turns)
    if abs(turns - row[TURNS]) > _WINDING_TOLERANCE:
        row[ROOM] = 0.0
    return row
