"""The one-sided Hausdorff distance of a hull, or a part of one, from the body within."""

from __future__ import annotations

import numpy as np

from guidefield.geometry.solid import Solid
from guidefield.geometry.surfaces import Surface
from guidefield.kernels.cover.hausdorff_distance import largest_distance

TOLERANCE = 1e-4
"""How much too large a stand-off may be given [m], for each metre that the surface extends and for one at least."""


def stand_off(
    around: Surface, body: Solid, enough: float = np.inf, tolerance: float = TOLERANCE, share: float = 0.0
) -> float:
    """Largest distance of points of a surface from a body [m], never too small.

    What is inside of a closed body is at no distance. The surface alone counts: what it encloses can't be reached from
    outside but through an opening about as narrow.

    Args:
        around: A surface about the body or a part of it, its hull for example.
        body: The body.
        enough: Beyond this [m] it is only said that the stand-off is more.
        tolerance: How much too large it may be given, as `TOLERANCE`.
        share: How much too large it may be given as a share of it, where that is more.
    """
    triangles = np.ascontiguousarray(around.corners.reshape(-1, 9))
    extent = float(np.ptp(around.vertices, axis=0).max())
    allowed = tolerance * max(1.0, extent)
    return float(largest_distance(triangles, body.tables, body.spans, body.closed, allowed, share, enough))
