"""The recipe of an obstacle, which makes its parts on demand; Coal trees of its triangles, many in patches.

`obstacle.py` writes recipes; the narrow phase (`collision/narrow_phase.py`) asks patch by patch.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from guidefield.geometry.cache import Allocate, Arrays, allocate_in_memory, make_in_place
from guidefield.geometry.convex import bvh
from guidefield.geometry.curve_order import curve_order
from guidefield.geometry.surfaces import box_about
from guidefield.kernels.distance.triangle_rows import corner_sums, runs_of_triangles
from guidefield.memo import memoized

PATCH = 8192  # most triangles in one tree, which Coal builds in some hundredths of a second: a matter of time


Whole = Callable[[], tuple[np.ndarray, np.ndarray]]  # makes the vertices (v, 3) [m] and triangles (t, 3) of a surface


class Facets:
    """Triangles that Coal judges as a surface, in the obstacle's own frame, of which at first only the number is known.

    `made` makes vertices (v, 3) [m], each used, and triangles (t, 3) on demand. By the hash `content` patches are kept.
    """

    def __init__(self, count: int, made: Whole, content: bytes = b"", box: np.ndarray | None = None) -> None:
        self.count, self._made, self._content = count, made, content
        if box is not None:
            vars(self)["box"] = box

    @cached_property
    def box(self) -> np.ndarray:
        """Lower and upper corner of the box about them, shape (2, 3) [m, own frame]."""
        return box_about(self._made()[0])

    @property
    def whole(self) -> Any:
        """All of them as one Coal tree."""
        return _tree(self)

    def surface(self) -> tuple[np.ndarray, np.ndarray]:
        """Return their vertices (v, 3) [m] and the triangles (t, 3)."""
        return self._made()

    @cached_property
    def patches(self) -> Patches | None:
        """Trees of neighbours; None where one tree is no more than `PATCH`."""
        return Patches(self._made, self._content) if self.count > PATCH else None


@memoized
def _tree(facets: Facets) -> Any:
    return bvh(*facets.surface())


class Patches:
    """Triangles as trees of at most `PATCH` neighbours, made on first use; with a hash their order is on disk."""

    def __init__(self, surface: Whole, content: bytes = b"") -> None:
        self._make = surface

        def write(allocate: Allocate) -> Arrays:
            return _write_patches(*self._surface, allocate)

        known = {"content": np.frombuffer(content, np.uint8), "patch": np.array(PATCH)}
        made = make_in_place("patches", known, write) if content else write(allocate_in_memory)
        self._triangles, (self._low, self._high) = made["triangles"], np.split(made["boxes"], 2, axis=1)
        self._shapes: dict[int, Any] = {}

    @cached_property
    def _surface(self) -> tuple[np.ndarray, np.ndarray]:
        return self._make()

    def __len__(self) -> int:
        return len(self._low)

    def apart(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Return distances (k,) of the patches' boxes from one with these corners [m]: lower bounds."""
        gaps = np.maximum(0.0, np.maximum(self._low - high, low - self._high))
        found: np.ndarray = np.sqrt((gaps * gaps).sum(axis=1))
        return found

    def shape(self, index: int) -> Any:
        """Return a patch as a Coal tree, in the obstacle's own frame."""
        if index not in self._shapes:
            corners = self._triangles[index * PATCH : (index + 1) * PATCH]
            used, local = np.unique(corners, return_inverse=True)
            self._shapes[index] = bvh(self._surface[0][used], local.reshape(-1, 3))
        return self._shapes[index]

    def nearest_first(self, low: np.ndarray, high: np.ndarray) -> Iterator[tuple[float, int]]:
        """Yield distance [m] and index of each patch, by its box's distance from a box with these corners, (3,)."""
        apart = self.apart(low, high)
        for index in np.argsort(apart, kind="stable").tolist():
            yield float(apart[index]), index


def _write_patches(vertices: np.ndarray, triangles: np.ndarray, allocate: Allocate) -> Arrays:
    vertices, triangles = np.ascontiguousarray(vertices, float), np.ascontiguousarray(triangles, np.int64)
    made = allocate({"triangles": ("<i4", triangles.shape), "boxes": ("<f8", (-(-len(triangles) // PATCH), 6))})
    sums = np.empty((len(triangles), 3))
    corner_sums(vertices, triangles, sums)
    runs_of_triangles(vertices, triangles, curve_order(sums), PATCH, made["triangles"], made["boxes"])
    return made


@dataclass(frozen=True, eq=False)
class Charges:
    """The charges of an obstacle, in rows, in the world [m].

    Triangles (n, 3, 3) and flat convex quads (n, 4, 3); spheres: centre, radius; capsules: both ends of the axis,
    radius; planes: unit normal, offset; boxes: centre, unit axes, full sizes; cloud: points, the area that each stands
    for [m^2], its softening length.
    """

    triangles: np.ndarray = field(default_factory=lambda: np.empty((0, 3, 3)))
    spheres: np.ndarray = field(default_factory=lambda: np.empty((0, 4)))
    capsules: np.ndarray = field(default_factory=lambda: np.empty((0, 7)))
    planes: np.ndarray = field(default_factory=lambda: np.empty((0, 4)))
    quads: np.ndarray = field(default_factory=lambda: np.empty((0, 4, 3)))
    boxes: np.ndarray = field(default_factory=lambda: np.empty((0, 15)))
    cloud: np.ndarray = field(default_factory=lambda: np.empty((0, 5)))


class Recipe(NamedTuple):
    """The makers of an obstacle's parts."""

    # makes, of its message, Coal geometry in its own frame, and ``T_world_shape``, a pinocchio.SE3
    body: Callable[[Any], tuple[Any, Any]]
    # makes, of its message, a triangulation in its own frame, vertices (v, 3) [m] and triangles (t, 3)
    surface: Callable[[Any], tuple[np.ndarray, np.ndarray]]
    charged: Callable[[Any, Any], Charges]  # makes, of its message and ``T_world_shape``, its share of the field
    solid: bool = True
    convex: bool = True  # true if Coal judges it as one convex body: distances are signed then
    facets: Facets | None = None  # the triangles that Coal judges; None for a convex body
    placement: Any | None = None  # ``T_world_shape``, if it is known before the body is made
    extent: float | None = None  # largest extent along an axis of its own frame [m], if it is declared by points
    content: bytes = b""  # hash of the geometry of a large mesh or cloud, whose results are kept on disk; else empty
