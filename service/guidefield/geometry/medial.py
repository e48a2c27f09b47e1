"""Balls from which covers and inner balls are chosen: about points of a body's medial axis, with their exact depths.

A ball about a point within a body that reaches further than its depth can be replaced: moved away from the nearest
surface and grown, it contains what it contained and leaves the body no further. Where that ends is the medial axis.
"""

from __future__ import annotations

import numpy as np

from guidefield.geometry.elements import Elements
from guidefield.geometry.solid import Solid
from guidefield.geometry.surfaces import Floats, Integers
from guidefield.kernels.cover.inscribed import tangent_balls


def medial_balls(body: Solid, elements: Elements, most: int, resolution: float, slack: float = 0.0) -> Floats:
    """Largest balls within a body that all but touch its surface in elements of it.

    Args:
        body: A closed body.
        elements: Of the body's surface.
        most: About how many pieces of them to start from.
        resolution: Of balls with centres closer than about this, one is kept [m].
        slack: By how much balls may miss the surface, so that they grow past facets of a round one [m].

    Returns:
        Centre and depth, shape (n, 4) [m], the deepest first; the balls are within the body.
    """
    corners, sources = elements.pieces.some(slice(None, None, max(1, len(elements.pieces.sources) // most)))
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    wide = lengths > 0.0
    points = np.ascontiguousarray(corners[wide].mean(axis=1))
    inward = -normals[wide] / lengths[wide, None]
    centres = np.empty_like(points)
    size = float(np.linalg.norm(np.ptp(body.surface.vertices, axis=0)))
    tangent_balls(points, inward, body.owners[sources[wide]], body.tables, body.spans, size, slack, centres)
    depths = body.depths(centres)
    order = np.argsort(-depths, kind="stable")
    order = order[depths[order] > 0.0]
    cells = np.floor(centres[order] / resolution).astype(np.int64)
    _, first = np.unique(_numbered(cells), return_index=True)
    kept = order[np.sort(first)]
    return np.column_stack([centres[kept], depths[kept]])


def _numbered(cells: Integers) -> Integers:
    """One number for each cell (n, 3) of a grid, shape (n,)."""
    if not len(cells):
        return np.empty(0, np.int64)
    offsets = cells - cells.min(axis=0)
    counts = offsets.max(axis=0) + 1
    numbers: Integers = (offsets[:, 0] * counts[1] + offsets[:, 1]) * counts[2] + offsets[:, 2]
    return numbers
