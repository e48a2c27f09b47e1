"""A surface in small elements: bodies of limited extent, known by their corners."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from guidefield.geometry.box_tree import box_tree
from guidefield.geometry.surfaces import Floats, Integers, area_of


class Pieces(NamedTuple):
    """Triangles, parts of those of a surface.

    Attributes:
        corners: Shape (n, 3, 3) [m].
        sources: Which triangle of the surface each is part of, shape (n,).
    """

    corners: Floats
    sources: Integers

    @property
    def area(self) -> float:
        """Area of all [m^2]."""
        return area_of(self.corners)

    def some(self, chosen: np.ndarray | slice) -> Pieces:
        """Those that indices (k,), a mask (n,) or a slice choose."""
        return Pieces(self.corners[chosen], self.sources[chosen])


class Elements(NamedTuple):
    """Pieces of a surface that lie together; each has at least one.

    Attributes:
        pieces: Those of the same element together.
        first: First piece of each element, and the number of all, shape (m + 1,).
        bounds: A ball about each element: centre and radius, shape (m, 4) [m].
    """

    pieces: Pieces
    first: Integers
    bounds: Floats

    @property
    def points(self) -> Floats:
        """Corners of all pieces, shape (3 n, 3) [m]."""
        return self.pieces.corners.reshape(-1, 3)

    @property
    def first_point(self) -> Integers:
        """First point of each element, and the number of all, shape (m + 1,)."""
        return 3 * self.first

    def some(self, chosen: np.ndarray) -> Elements:
        """The elements that a mask, shape (m,), chooses."""
        counts = np.diff(self.first)
        return Elements(
            self.pieces.some(np.repeat(chosen, counts)),
            np.concatenate([[0], np.cumsum(counts[chosen])]),
            np.ascontiguousarray(self.bounds[chosen]),
        )


def bisected(pieces: Pieces, size: float) -> Pieces:
    """Pieces halved at the middle of their longest edge until none has an edge longer than `size` [m]."""
    corners, sources = pieces
    done = []
    while len(corners):
        lengths = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
        large = lengths.max(axis=1) > size
        done.append(Pieces(corners[~large], sources[~large]))
        corners, sources, longest = corners[large], sources[large], lengths[large].argmax(axis=1)
        row = np.arange(len(corners))
        a, b, c = (corners[row, (longest + turn) % 3] for turn in range(3))
        middle = 0.5 * (a + b)
        corners = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
        sources = np.tile(sources, 2)
    return joined(done)


def joined(parts: list[Pieces]) -> Pieces:
    """All pieces of several."""
    return Pieces(np.concatenate([part.corners for part in parts]), np.concatenate([part.sources for part in parts]))


def gathered(pieces: Pieces, size: float) -> Elements:
    """Elements of pieces whose centroids lie in the same cell of a grid of width `size` [m]; neighbours together."""
    centroids = pieces.corners.mean(axis=1)
    cells = np.floor((centroids - centroids.min(axis=0)) / size).astype(np.int64)
    counts = cells.max(axis=0) + 1
    _, owner = np.unique((cells[:, 0] * counts[1] + cells[:, 1]) * counts[2] + cells[:, 2], return_inverse=True)
    owner = owner.reshape(-1)
    place = np.empty(int(owner.max()) + 1, np.int64)
    low, high = _boxes(pieces.corners, owner)
    place[box_tree(low, high).order] = np.arange(len(place))
    owner = place[owner]
    order = np.argsort(owner, kind="stable")
    pieces, first = pieces.some(order), np.searchsorted(owner[order], np.arange(len(place) + 1))
    return Elements(pieces, first, _bounds(pieces.corners.reshape(-1, 3), 3 * first))


def blocks(elements: Elements) -> Floats:
    """A ball about every 64 elements, the last perhaps fewer, shape (m / 64 rounded up, 4) [m]."""
    first = np.append(elements.first_point[:-1:64], elements.first_point[-1])
    return _bounds(elements.points, first)


def _boxes(corners: Floats, owner: Integers) -> tuple[Floats, Floats]:
    """Lower and upper corners (m, 3) of boxes about the triangles (n, 3, 3) of each owner."""
    count = int(owner.max()) + 1
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, owner, corners.min(axis=1))
    np.maximum.at(high, owner, corners.max(axis=1))
    return low, high


def _bounds(points: Floats, first: Integers) -> Floats:
    """A ball about each run of points: centre and radius, shape (m, 4) [m]."""
    low, high = (extreme.reduceat(points, first[:-1]) for extreme in (np.minimum, np.maximum))
    centres = 0.5 * (low + high)
    offsets = np.linalg.norm(points - np.repeat(centres, np.diff(first), axis=0), axis=1)
    radii = np.maximum.reduceat(offsets, first[:-1]) * (1.0 + 1e-12)
    return np.column_stack([centres, radii])


def united(parts: list[Elements]) -> Elements:
    """All elements of several."""
    counts = np.concatenate([np.diff(part.first) for part in parts])
    return Elements(
        joined([part.pieces for part in parts]),
        np.concatenate([[0], np.cumsum(counts)]),
        np.concatenate([part.bounds for part in parts]),
    )
