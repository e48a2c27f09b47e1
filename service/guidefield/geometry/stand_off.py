"""How far a hull, or a part of one, stands off the body that it is about."""

from __future__ import annotations

import numpy as np

from guidefield.geometry.solid import Solid
from guidefield.geometry.surfaces import Surface
from guidefield.kernels.stand_off import largest_distance

TOLERANCE = 1e-4
"""How much too large a stand-off may be given [m]."""


def stand_off(around: Surface, body: Solid, enough: float = np.inf) -> float:
    """Largest distance of points of a surface from a body [m], never too small.

    What is inside of a closed body is at no distance. The surface alone counts: what it encloses can't be reached from
    outside but through an opening about as narrow.

    Args:
        around: A surface about the body or a part of it, its hull for example.
        body: The body.
        enough: Beyond this [m] it is only said that the stand-off is more.
    """
    triangles = np.ascontiguousarray(around.corners.reshape(-1, 9))
    return float(largest_distance(triangles, body.tables, body.spans, body.closed, TOLERANCE, enough))
