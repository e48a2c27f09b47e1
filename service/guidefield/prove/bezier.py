"""Points, halves and ranges of Bezier curves."""

from __future__ import annotations

from typing import cast

import numpy as np

from guidefield.kernels.prove.bezier import find_halves, find_ranges
from guidefield.robot.model.spaces import ChartCurves, ChartPoint, ChartPoints


def ranges(controls: ChartCurves) -> tuple[ChartPoints, ChartPoints]:
    """The least and the largest of each curve's control points, shape (m, k, nv), by coordinate: (m, nv) each."""
    low, high = np.empty((2, len(controls), controls.shape[2]))
    find_ranges(np.ascontiguousarray(controls), low, high)
    return cast(ChartPoints, low), cast(ChartPoints, high)


def point_on(controls: ChartPoints, parameter: float) -> ChartPoint:
    """Return the point (nv,) of a Bezier curve, control points (k, nv), at a parameter by de Casteljau's scheme."""
    row = controls
    while len(row) > 1:
        row = row[:-1] + parameter * (row[1:] - row[:-1])
    point: ChartPoint = row[0]
    return point


def halved(controls: ChartCurves) -> ChartCurves:
    """Both halves of each Bezier curve, in order, by de Casteljau's scheme.

    Args:
        controls: Control points, shape (n, k, nv).

    Returns:
        Shape (2 n, k, nv).
    """
    halves = cast(ChartCurves, np.empty((2 * len(controls), *controls.shape[1:])))
    find_halves(np.ascontiguousarray(controls), halves)
    return halves


def restricted(controls: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Control points of parts of Bezier curves, by their blossom.

    Args:
        controls: Of the curves, shape (n, k, nv).
        low: Parameters where the parts begin, shape (n,).
        high: Where they end, shape (n,).

    Returns:
        Shape (n, k, nv).
    """
    order = controls.shape[1]
    parts = np.empty_like(controls)
    a, b = low[:, None, None], high[:, None, None]
    for index in range(order):
        row = controls
        for step in range(order - 1):
            share = b if step < index else a
            row = row[:, :-1] + share * (row[:, 1:] - row[:, :-1])
        parts[:, index] = row[:, 0]
    return parts
