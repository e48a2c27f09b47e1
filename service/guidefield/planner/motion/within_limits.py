"""Keeping a cubic curve within position limits between its knots: its control points are brought within."""

from __future__ import annotations

from typing import cast

import numpy as np

from guidefield.prove.position_limits import excesses
from guidefield.robot.model.spaces import ChartCurves, ChartPoint, ChartPoints, ChartRates

ROUNDING = 1e-12
"""A curve that is beyond a limit by no more than this keeps it [rad or m]."""


def leaving(
    knots: np.ndarray, values: ChartPoints, slopes: ChartRates, lower: ChartPoint, upper: ChartPoint
) -> np.ndarray:
    """Which coordinates of a cubic Hermite curve leave their limits, at or between its knots.

    Args:
        knots: Shape (n,), n >= 2, increasing.
        values: Shape (n, c) [rad or m].
        slopes: Shape (n, c) [rad or m, for each unit of the knots].
        lower: Limits, shape (c,) [rad or m]; infinite where there are none.

    Returns:
        Shape (c,), bool.
    """
    beyond, _ = excesses(bezier(knots, values, slopes), lower, upper)
    left: np.ndarray = np.any(beyond > ROUNDING, axis=0)
    return left


def bezier(knots: np.ndarray, values: ChartPoints, slopes: ChartRates) -> ChartCurves:
    """Control points of a cubic Hermite curve's pieces, shape (n - 1, 4, c); arguments as those of `leaving`."""
    third = (knots[1:] - knots[:-1])[:, None] / 3.0
    start, end = values[:-1], values[1:]
    curves = cast(ChartCurves, np.empty((len(start), 4, values.shape[1])))
    curves[:, 0], curves[:, 3] = start, end
    curves[:, 1], curves[:, 2] = start + slopes[:-1] * third, end - slopes[1:] * third
    return curves


def smoothly_within(
    knots: np.ndarray, values: ChartPoints, slopes: ChartRates, lower: ChartPoint, upper: ChartPoint
) -> tuple[ChartPoints, ChartRates]:
    """A C² cubic curve brought within limits, and still C²: it leaves its values where it has to, never at its ends.

    Its de Boor points are brought within, in whose hull it is. With steps h, that of knot i is b - (h_{i-1} / h_i)
    (c - b), b and c being the inner control points of the piece that begins there (Farin, Curves and Surfaces for
    CAGD, 2002, chapter 8).

    Args:
        knots: Shape (n,), n >= 2, increasing.
        values: Within the limits at both ends, shape (n, c) [rad or m].
        slopes: Shape (n, c) [rad or m, for each unit of the knots].
        lower: Limits, shape (c,) [rad or m].

    Returns:
        Values and slopes, each of shape (n, c).
    """
    h, inner = np.diff(knots)[:, None], bezier(knots, values, slopes)[:, 1:3]
    before, after = np.vstack([np.zeros(1), h]), np.vstack([h, np.zeros(1)])  # steps about each knot
    points = inner[:, 0] - before[:-1] / h * (inner[:, 1] - inner[:, 0])
    points = np.clip(np.vstack([points, inner[-1:, 1]]), lower, upper)
    along = np.diff(points, axis=0) / (before[:-1] + h + after[1:])
    first, second = points[:-1] + before[:-1] * along, points[:-1] + (before[:-1] + h) * along
    kept = values.copy()
    kept[1:-1] = second[:-1] + h[:-1] / (h[:-1] + h[1:]) * (first[1:] - second[:-1])
    rates = np.vstack([(first - kept[:-1]) / h, (kept[-1:] - second[-1:]) / h[-1:]])
    return kept, 3.0 * rates


def bounded_slopes(
    knots: np.ndarray, values: ChartPoints, slopes: ChartRates, lower: ChartPoint, upper: ChartPoint
) -> ChartRates:
    """Slopes with which a cubic Hermite curve through values keeps limits; C² it need not be.

    The control points next to a knot, a third of a step along the slope away from its value, are brought within.

    Args:
        knots: Shape (n,), n >= 2, increasing.
        values: Within the limits, shape (n, c) [rad or m].
        slopes: Shape (n, c) [rad or m, for each unit of the knots].
        lower: Limits, shape (c,) [rad or m].

    Returns:
        Shape (n, c).
    """
    thirds = np.diff(knots)[:, None] / 3.0
    above, below = np.maximum(upper - values, 0.0), np.maximum(values - lower, 0.0)
    most, least = np.full(values.shape, np.inf), np.full(values.shape, -np.inf)
    most[:-1], least[:-1] = above[:-1] / thirds, -below[:-1] / thirds
    most[1:], least[1:] = np.minimum(most[1:], below[1:] / thirds), np.maximum(least[1:], -above[1:] / thirds)
    bounded: ChartRates = np.clip(slopes, least, most)
    return bounded
