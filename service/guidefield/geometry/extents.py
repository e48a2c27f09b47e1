"""The box about points, along the axes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def box_about(points: Floats) -> Floats:
    """Lower and upper corner of the box about points, shape (n, 3), n >= 1; shape (2, 3)."""
    columns = [points[:, axis] for axis in range(3)]  # one after another, which NumPy does in a fifth
    return np.array([[column.min() for column in columns], [column.max() for column in columns]])


def extents(points: Floats) -> Floats:
    """How far points, shape (n, 3), n >= 1, reach along each axis; shape (3,)."""
    low, high = box_about(points)
    along: Floats = high - low
    return along
