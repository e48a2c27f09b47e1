"""Triangles clipped at planes, and the corners of convex cells."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from guidefield.geometry.directions import heights_along
from guidefield.geometry.elements import Pieces, join_pieces
from guidefield.geometry.solid import Solid
from guidefield.geometry.surfaces import Floats

_PARALLEL = 1e-6
"""Three planes whose normals span less than this meet nowhere that matters."""


def clipped(pieces: Pieces, plane: Floats) -> Pieces:
    """The parts of triangles that lie below a plane: n.p <= d.

    Args:
        pieces: The triangles.
        plane: Unit normal n and offset d, shape (4,) [m], in the triangles' frame.
    """
    heights = heights_along(pieces.corners, plane[:3]) - plane[3]
    below = heights <= 0.0
    count = below.sum(axis=1)
    return join_pieces(
        [pieces.some(count == 3), *_cut(pieces, heights, below, count, 1), *_cut(pieces, heights, below, count, 2)]
    )


def _cut(pieces: Pieces, heights: Floats, below: np.ndarray, count: np.ndarray, corners_below: int) -> list[Pieces]:
    """What lies below of the triangles that have one or two corners below: a triangle, or two."""
    chosen = np.flatnonzero(count == corners_below)
    rows = np.arange(len(chosen))
    # the corner that is alone on its side comes first
    first = (below[chosen] if corners_below == 1 else ~below[chosen]).argmax(axis=1)
    a, b, c = (pieces.corners[chosen][rows, (first + turn) % 3] for turn in range(3))
    ha, hb, hc = (heights[chosen][rows, (first + turn) % 3][:, None] for turn in range(3))
    sources = pieces.sources[chosen]
    # from what is below, so that neighbours have the same point of their edge, bit for bit
    if corners_below == 1:
        ab, ac = a + ha / (ha - hb) * (b - a), a + ha / (ha - hc) * (c - a)
        return [Pieces(np.stack([a, ab, ac], axis=1), sources)]
    ab, ac = b + hb / (hb - ha) * (a - b), c + hc / (hc - ha) * (a - c)
    return [Pieces(np.stack([ab, b, c], axis=1), sources), Pieces(np.stack([ab, c, ac], axis=1), sources)]


def corners_of_cell(body: Solid, planes: Floats) -> Floats:
    """Corners (n, 3) of a convex cell that lie within a closed body.

    Args:
        body: The body.
        planes: Unit normals and offsets of the cell's sides, shape (k, 4) [m].
    """
    triples = [planes[list(three)] for three in combinations(range(len(planes)), 3)]
    meeting = [three for three in triples if abs(np.linalg.det(three[:, :3])) > _PARALLEL]
    if not meeting:
        return np.empty((0, 3))
    points = np.array([np.linalg.solve(three[:, :3], three[:, 3]) for three in meeting])
    within = (points @ planes[:, :3].T <= planes[:, 3] + 1e-12).all(axis=1)
    points = points[within]
    corners: Floats = points[body.depths(points) > 0.0]
    return corners
