"""What is inside of a body: proved to be in balls that contain its surface, and put into balls where it isn't."""

from __future__ import annotations

import numpy as np

from guidefield.geometry.solid import Solid
from guidefield.geometry.surfaces import Floats
from guidefield.kernels.cover.cell_proof import uncovered_cells

_ROOM = 4096
"""Cells that are asked for at a time."""

_ROOT_SLACK = 1.0 + 1e-9


def contain_interior(body: Solid, balls: Floats, delta: float, margin: float) -> Floats:
    """Balls that contain all of a closed body, from balls that contain its surface by a margin.

    For every cell of the inside that is in no ball, the ball that has to grow least is grown; if none may, because it
    would leave the body by more than `delta`, there is a new one about the cell.

    Args:
        body: A closed body.
        balls: Shape (n, 4) [m].
        delta: Largest overhang [m].
        margin: Every point this close to the surface is in a ball [m].

    Returns:
        The same balls in the same order, some of them larger, then those that were added; shape (m, 4).
    """
    balls = np.ascontiguousarray(balls)
    allowed = body.depths(balls[:, :3]) + delta
    low, high = body.surface.vertices.min(axis=0), body.surface.vertices.max(axis=0)
    box = np.array([[*(0.5 * (low + high)), 0.5 * float((high - low).max()) * _ROOT_SLACK]])
    cells = np.empty((_ROOM, 5))
    while count := uncovered_cells(balls, box, margin, body.tables, body.spans, cells):
        for cell in cells[:count]:
            needed = _corner_distance(balls, cell)
            if (needed <= balls[:, 3]).any():
                continue
            growth = np.where(needed <= allowed, needed - balls[:, 3], np.inf)
            best = int(growth.argmin())
            if growth[best] < np.inf:
                balls[best, 3] = needed[best]
                continue
            balls = np.vstack([balls, [*cell[:3], cell[4] + delta]])
            allowed = np.append(allowed, cell[4] + delta)
    return balls


def _corner_distance(balls: Floats, cell: Floats) -> Floats:
    """Distances (n,) from the balls' centres to the farthest corner of a cell: centre and half size [m]."""
    offsets = np.abs(balls[:, :3] - cell[:3]) + cell[3]
    # a little more, so that the kernel's rounding agrees that the cell is contained
    distances: Floats = np.sqrt((offsets * offsets).sum(axis=1)) * (1.0 + 1e-12)
    return distances
