"""Two directions across a third."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def across(direction: NDArray[np.float64]) -> NDArray[np.float64]:
    """Two unit vectors, shape (2, 3), that make a right-handed frame with a unit vector, shape (3,)."""
    first = np.cross(direction, np.eye(3)[np.abs(direction).argmin()])
    first /= np.linalg.norm(first)
    return np.array([first, np.cross(direction, first)])
