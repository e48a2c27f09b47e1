"""Planes to cut fields by."""

import numpy as np

from guidefield.scene.field_slice import SlicePlane


def horizontal(centre: tuple[float, float, float], size: float) -> SlicePlane:
    """A square seen from above: x to the right, y up."""
    corner = np.array([centre[0] - 0.5 * size, centre[1] + 0.5 * size, centre[2]])
    return SlicePlane(corner, np.array([size, 0.0, 0.0]), np.array([0.0, -size, 0.0]))
