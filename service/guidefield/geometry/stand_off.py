"""How far a hull stands off the mesh that it is the hull of."""

from __future__ import annotations

import numpy as np

from guidefield.geometry.solid import Solid
from guidefield.geometry.surfaces import Surface
from guidefield.kernels.stand_off import largest_distance

TOLERANCE = 1e-4
"""How much too large a stand-off may be given [m]."""


def stand_off(around: Surface, body: Solid, enough: float = np.inf) -> float:
    """Largest distance of points of a surface from a body's surface [m], never too small.

    Args:
        around: A surface about the body, its hull for example.
        body: The body.
        enough: Beyond this [m] it is only said that the stand-off is more.
    """
    triangles = np.ascontiguousarray(around.corners.reshape(-1, 9))
    return float(largest_distance(triangles, body.tables, body.spans, TOLERANCE, enough))
