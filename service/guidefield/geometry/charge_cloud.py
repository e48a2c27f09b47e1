"""Point clouds as charges: an approximation of the surface they were taken from, which can leak between the points."""

from __future__ import annotations

import math

import numpy as np

from guidefield.geometry.surfaces import Floats

SOFTENING = 0.1
"""Softening length over the spacing: the field of a point stays finite."""

NEIGHBOURS = 6
"""So many neighbours tell how densely points lie."""

_HOLE = 16.5
"""Potential in the middle of a hole of a square grid, times its spacing: that of a wall at 0.38 spacings."""

_AT_ONCE = 512
"""Points whose distances to all are held in memory."""


def spacings(points: Floats, least: float, most: Floats | float) -> Floats:
    """Spacing of the square grid that is as dense as a cloud is around each of its points, shape (n,) [m].

    pi r^2 / k with r the distance of the k-th neighbour: unbiased for points spread at random on a smooth surface, 5 %
    too much for those of a square grid.

    Args:
        points: Shape (n, 3) [m].
        least: What is denser counts as this [m], positive: points may coincide.
        most: What is sparser counts as this [m], all or each, shape (n,): one that is alone stands for no more.
    """
    k = min(NEIGHBOURS, len(points) - 1)
    if k < 1:
        return np.broadcast_to(np.asarray(most, float), len(points)).copy()
    squares = (points * points).sum(axis=1)
    found = np.empty(len(points))
    for first in range(0, len(points), _AT_ONCE):
        some = slice(first, first + _AT_ONCE)
        apart = squares[some, None] + squares - 2.0 * (points[some] @ points.T)
        found[some] = np.partition(apart, k, axis=1)[:, k]
    spread: Floats = np.sqrt(np.maximum(found, 0.0) * (math.pi / k))
    return np.clip(spread, least, most)


def cloud_rows(points: Floats, spacing: Floats | float, charge: float = 1.0) -> Floats:
    """Points of a surface sampled about evenly, as rows of `field_tables(cloud=...)`, shape (n, 5).

    From a distance of a spacing on, a sheet of such points has the potential of the sheet to within 1 %. Nearer than
    that the field is lumpy, and finite in the holes: see `leak_limit`.

    Args:
        points: Shape (n, 3) [m], in the frame of the field.
        spacing: Distance of neighbours [m], of all or of each, shape (n,); every point stands for its square.
        charge: Charge per area [1].

    Raises:
        ValueError: if a spacing isn't positive.
    """
    if not np.all(np.asarray(spacing) > 0.0):
        raise ValueError(f"`spacing` must be positive, got {np.min(spacing)} m")
    rows = np.empty((len(points), 5))
    rows[:, :3], rows[:, 3], rows[:, 4] = points, charge * np.square(spacing), SOFTENING * np.asarray(spacing)
    return rows


def leak_limit(spacing: float, charge: float = 1.0) -> float:
    """Potential above which a point must count as in contact with a cloud, else it may slip through a hole [1/m].

    Half of what the middle of a hole has: where spacings vary by less than a factor of two no way leads through. No
    certificate leans on it: for those a cloud is judged as bodies.
    """
    return 0.5 * _HOLE * charge / spacing
