"""Point clouds as charges: an approximation of the surface they were taken from, which can leak between the points."""

from __future__ import annotations

import numpy as np

from guidefield.geometry.surfaces import Floats

SOFTENING = 0.1
"""Softening length over the spacing: the field of a point stays finite."""

_HOLE = 16.5
"""Potential in the middle of a hole of a square grid, times its spacing: that of a wall at 0.38 spacings."""


def cloud_rows(points: Floats, spacing: float, charge: float = 1.0) -> Floats:
    """Points of a surface sampled about evenly, as rows of `field_tables(cloud=...)`, shape (n, 5).

    From a distance of a spacing on, a sheet of such points has the potential of the sheet to within 1 %. Nearer than
    that the field is lumpy, and finite in the holes: see `leak_limit`.

    Args:
        points: Shape (n, 3) [m].
        spacing: Distance of neighbours [m]; every point stands for its square.
        charge: Charge per area.
    """
    if not spacing > 0.0:
        raise ValueError(f"`spacing` must be positive, got {spacing} m")
    rows = np.empty((len(points), 5))
    rows[:, :3], rows[:, 3], rows[:, 4] = points, charge * spacing**2, SOFTENING * spacing
    return rows


def leak_limit(spacing: float, charge: float = 1.0) -> float:
    """Potential above which a point must count as in contact with a cloud, else it may slip through a hole [1/m].

    Half of what the middle of a hole has: where spacings vary by less than a factor of two no way leads through.
    """
    return 0.5 * _HOLE * charge / spacing
