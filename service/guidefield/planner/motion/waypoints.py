"""The waypoints of a path: its length, and its straight pieces."""

from __future__ import annotations

import numpy as np

from guidefield.robot.model.spaces import ChartCurves, ChartPoints


def length_of(path: ChartPoints, units: np.ndarray | float = 1.0) -> float:
    """Length of a path of chart points (n, nv), by a group's metric where its units (nv,) are given [rad or m]."""
    along = (path[1:] - path[:-1]) / units
    return float(np.sqrt(np.einsum("ij,ij->i", along, along)).sum())


def polyline(path: ChartPoints) -> ChartCurves:
    """Straight pieces between chart points, shape (n, nv), as Bezier control points, shape (n - 1, 2, nv).

    A single point is one piece.
    """
    if len(path) == 1:
        return np.repeat(path[None], 2, axis=1)
    return np.stack([path[:-1], path[1:]], axis=1)
