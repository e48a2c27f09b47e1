"""The triangles of an obstacle as Coal takes them: one tree, or where there are very many, trees of neighbours.

Coal sorts triangles into a tree in one call that nobody can interrupt, for three microseconds each. Of a scanned hall a
robot meets a corner: the trees of all that is elsewhere are never made.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cached_property
from typing import Any

import coal
import numpy as np

from guidefield.geometry.curve_order import curve_order
from guidefield.geometry.extents import box_about

PATCH = 8192
"""Most triangles in one tree; a call of Coal's for so many takes some hundredths of a second."""


def bvh(vertices: np.ndarray, triangles: np.ndarray) -> Any:
    """Triangles as a Coal tree of oriented boxes: surfaces only, no inside.

    Args:
        vertices: Shape (v, 3) [m], in the shape's frame.
        triangles: Indices of vertices, shape (t, 3).
    """
    tree = coal.BVHModelOBBRSS()
    tree.beginModel(len(triangles), len(vertices))
    tree.addVertices(np.ascontiguousarray(vertices, float))
    tree.addTriangles(np.ascontiguousarray(triangles, np.int64))
    tree.endModel()
    tree.computeLocalAABB()
    return tree


class Facets:
    """Triangles that Coal judges as a surface.

    Args:
        count: How many there are.
        made: Makes their vertices (v, 3) [m], each used, and the triangles (t, 3), in the obstacle's own frame.
    """

    def __init__(self, count: int, made: Callable[[], tuple[np.ndarray, np.ndarray]]) -> None:
        self.count, self._made = count, made

    @cached_property
    def box(self) -> np.ndarray:
        """Lower and upper corner of the box about them, shape (2, 3) [m, own frame]."""
        return box_about(self._made()[0])

    @cached_property
    def whole(self) -> Any:
        """All of them as one Coal tree."""
        return bvh(*self._made())

    @cached_property
    def patches(self) -> Patches | None:
        """Trees of neighbours; None where one tree is no more than `PATCH`."""
        return Patches(*self._made()) if self.count > PATCH else None


class Patches:
    """Triangles as trees of at most `PATCH` neighbours, each made when it is first asked for.

    Args:
        vertices: Shape (v, 3) [m].
        triangles: Shape (t, 3).
    """

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray) -> None:
        self._vertices = vertices
        a, b, c = (vertices[column] for column in triangles.T)
        order = curve_order(a + b + c)
        self._triangles, starts = triangles[order], np.arange(0, len(triangles), PATCH)
        low = np.minimum(np.minimum(a, b), c)[order]
        high = np.maximum(np.maximum(a, b), c)[order]
        self._low, self._high = np.minimum.reduceat(low, starts), np.maximum.reduceat(high, starts)
        self._shapes: dict[int, Any] = {}

    def __len__(self) -> int:
        return len(self._low)

    def apart(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Distances of the patches' boxes from a box with these corners, shapes (3,), at most those of what is in them.

        Returns:
            Shape (k,) [m]; 0 where boxes overlap.
        """
        gaps = np.maximum(0.0, np.maximum(self._low - high, low - self._high))
        found: np.ndarray = np.sqrt((gaps * gaps).sum(axis=1))
        return found

    def shape(self, index: int) -> Any:
        """A patch as a Coal tree, in the frame of all."""
        if index not in self._shapes:
            corners = self._triangles[index * PATCH : (index + 1) * PATCH]
            used, local = np.unique(corners, return_inverse=True)
            self._shapes[index] = bvh(self._vertices[used], local.reshape(-1, 3))
        return self._shapes[index]

    def nearest_first(self, low: np.ndarray, high: np.ndarray) -> Iterator[tuple[float, int]]:
        """Patches by the distance of their boxes from a box with these corners, shapes (3,), the nearest first [m]."""
        apart = self.apart(low, high)
        for index in np.argsort(apart, kind="stable").tolist():
            yield float(apart[index]), index
