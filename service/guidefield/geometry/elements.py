"""Cut a surface into small elements, sets of neighbouring triangles, each with its corners and a ball about it.

A ball that contains an element's corners contains the element: covers rely on it, and so pieces must be the surface
without a gap, and bounds must not be too small.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from guidefield.geometry.curve_order import curve_order
from guidefield.geometry.surfaces import Floats, Integers, area_of
from guidefield.kernels.cover.pieces import (
    balls_about,
    cell_middles,
    distinct_points,
    gather,
    grid_cells,
    halve,
    longest_edges,
    stable_order,
)


class Pieces(NamedTuple):
    """Triangles, shape (n, 3, 3) [m], that are parts of those of a surface, shape (n,)."""

    corners: Floats
    sources: Integers

    @property
    def area(self) -> float:
        """Area of all [m^2]."""
        return area_of(self.corners)

    def some(self, chosen: np.ndarray | slice) -> Pieces:
        """Return the pieces that indices (k,), a mask (n,) or a slice choose."""
        return Pieces(self.corners[chosen], self.sources[chosen])


class Elements(NamedTuple):
    """Pieces of a surface that lie together, at least one in each element."""

    pieces: Pieces  # those of the same element together
    first: Integers  # first piece of each element, and the number of all, shape (m + 1,)
    points: Floats  # corners of the pieces of each element, equal ones once, shape (k, 3) [m]
    first_point: Integers  # first point of each element, and the number of all, shape (m + 1,)
    bounds: Floats  # a ball about each element: centre and radius, shape (m, 4) [m]

    def some(self, chosen: np.ndarray) -> Elements:
        """Return the elements that a mask, shape (m,), chooses."""
        if chosen.all():
            return self
        counts, of_points = np.diff(self.first), np.diff(self.first_point)
        return Elements(
            self.pieces.some(np.repeat(chosen, counts)),
            _starts(counts[chosen]),
            self.points[np.repeat(chosen, of_points)],
            _starts(of_points[chosen]),
            np.ascontiguousarray(self.bounds[chosen]),
        )


def bisect_pieces(pieces: Pieces, size: float) -> Pieces:
    """Pieces halved at the middle of their longest edge until none has an edge longer than `size` [m]."""
    corners, sources = np.ascontiguousarray(pieces.corners), np.ascontiguousarray(pieces.sources)
    done = []
    while len(corners):
        edges = np.empty(len(corners), np.int64)
        large = longest_edges(corners, size, edges)
        small, halves = _allocate(len(corners) - large), _allocate(2 * large)
        halve(corners, sources, edges, *small, *halves)
        done.append(small)
        corners, sources = halves
    return join_pieces(done)


def _allocate(count: int) -> Pieces:
    return Pieces(np.empty((count, 3, 3)), np.empty(count, np.int64))


def join_pieces(parts: list[Pieces]) -> Pieces:
    """Return all pieces of several."""
    return Pieces(np.concatenate([part.corners for part in parts]), np.concatenate([part.sources for part in parts]))


def gather_elements(pieces: Pieces, size: float) -> Elements:
    """Elements of pieces whose centroids lie in the same cell of a grid of width `size` [m]; neighbours together."""
    corners, count = np.ascontiguousarray(pieces.corners), len(pieces.sources)
    cells, order, first = np.empty(count, np.int64), np.empty(count, np.int64), np.empty(count + 1, np.int64)
    grid_cells(corners, size, cells)
    stable_order(cells, order)
    middles = np.empty((count, 3))
    found = cell_middles(corners, cells, order, first, middles)
    turn = curve_order(middles[:found])
    together, starts = _allocate(count), np.empty(found + 1, np.int64)
    gather(corners, np.ascontiguousarray(pieces.sources), order, first, turn, *together, starts)
    points, first_point = np.empty((3 * count, 3)), np.empty(found + 1, np.int64)
    points = points[: distinct_points(together.corners.reshape(-1, 3), 3 * starts, points, first_point)]
    return Elements(together, starts, points, first_point, _balls(points, first_point))


def blocks(elements: Elements) -> Floats:
    """A ball about every 64 elements, the last perhaps fewer, shape (m / 64 rounded up, 4) [m]."""
    first = np.append(elements.first_point[:-1:64], elements.first_point[-1])
    return _balls(elements.points, first)


def _balls(points: Floats, first: Integers) -> Floats:
    balls = np.empty((len(first) - 1, 4))
    balls_about(points, first, balls)
    return balls


def unite_elements(parts: list[Elements]) -> Elements:
    """Return all elements of several."""
    return Elements(
        join_pieces([part.pieces for part in parts]),
        _starts(np.concatenate([np.diff(part.first) for part in parts])),
        np.concatenate([part.points for part in parts]),
        _starts(np.concatenate([np.diff(part.first_point) for part in parts])),
        np.concatenate([part.bounds for part in parts]),
    )


def _starts(counts: Integers) -> Integers:
    return np.concatenate([[0], np.cumsum(counts)])
