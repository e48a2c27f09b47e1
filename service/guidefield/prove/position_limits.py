"""The exact excess of a motion beyond the joints' position limits, between its samples too.

A Bezier curve lies between the least and the largest of its control points. Where these are beyond a limit the curve is
halved: its ends are on it, and what its control points are off it falls to a quarter each time.
"""

from __future__ import annotations

import numpy as np

from guidefield.prove.bezier import halved, ranges
from guidefield.prove.settings import LIMITS
from guidefield.robot.model.spaces import ChartCurves, ChartPoint


def excesses(pieces: ChartCurves, lower: ChartPoint, upper: ChartPoint) -> tuple[np.ndarray, np.ndarray]:
    """By how much each coordinate of each piece is beyond its limits at most, and where.

    Args:
        pieces: Bezier control points in the group's chart, shape (m, k, nv) [rad or m].
        lower: Limits, shape (nv,) [rad or m]; infinite where there are none.

    Returns:
        The largest excess, shape (m, nv) [rad or m]; where no control point is beyond a limit a bound of it, which
        isn't positive but for rounding. The parameter of its place on the piece, from 0 to 1, shape (m, nv).
    """
    low, high = ranges(pieces)
    most, places = np.maximum(lower - low, high - upper), np.zeros(low.shape)
    which, at = np.nonzero(most > LIMITS.exact)
    if len(which):
        most[which, at], places[which, at] = _largest(pieces[which, :, at], lower[at], upper[at])
    return most, places


def _largest(curves: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The largest excess of curves of one coordinate each, control points (p, k), limits (p,); its parameter: (p,)."""
    ends = np.maximum(lower[:, None] - curves[:, [0, -1]], curves[:, [0, -1]] - upper[:, None])
    most, places = ends.max(axis=1), np.argmax(ends, axis=1).astype(float)
    parts, of, starts, width = curves[:, :, None], np.arange(len(curves)), np.zeros(len(curves)), 1.0
    for _ in range(LIMITS.most_halvings):
        parts, of, starts, width = halved(parts), np.repeat(of, 2), np.repeat(starts, 2), 0.5 * width
        starts[1::2] += width
        begun = np.maximum(lower[of] - parts[:, 0, 0], parts[:, 0, 0] - upper[of])
        for k in np.flatnonzero(begun > most[of]):
            if begun[k] > most[of[k]]:
                most[of[k]], places[of[k]] = begun[k], starts[k]
        reached = np.maximum(lower[of] - parts.min(axis=(1, 2)), parts.max(axis=(1, 2)) - upper[of])
        left = reached > np.maximum(most[of], 0.0) + LIMITS.exact
        if not left.any():
            break
        parts, of, starts = parts[left], of[left], starts[left]
    return most, places
