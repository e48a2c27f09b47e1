"""Where the control points of curves lie: in a box, and near a straight way through its middle.

A curve is a convex combination of its control points. So it stays in the box of them; and it stays off a straight way
by no more, in each coordinate, than the one of them that is farthest off.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from guidefield.robot.model.spaces import ChartCurves, ChartPoints, ChartRates


class Chords(NamedTuple):
    """Boxes and straight ways about s parts of a motion.

    Every point of a part is m + h with |h| <= half widths, and it is m + t c + o with |t| <= 1 and |o| <= off.

    Attributes:
        middles: m, of the boxes, shape (s, nv) [rad or m].
        half_widths: Of the boxes, shape (s, nv) [rad or m].
        chords: c, half of the way, along the part's first and last point, shape (s, nv) [rad or m].
        off: Shape (s, nv) [rad or m].
    """

    middles: ChartPoints
    half_widths: np.ndarray
    chords: ChartRates
    off: np.ndarray


def chords_of(parts: Sequence[ChartCurves]) -> Chords:
    """The chords of parts, each of some Bezier curves one behind the other: control points (m, k, nv)."""
    sizes = np.array([part.shape[0] * part.shape[1] for part in parts])
    starts, points = np.cumsum(sizes) - sizes, np.concatenate(parts).reshape(-1, parts[0].shape[2])
    low, high = np.minimum.reduceat(points, starts), np.maximum.reduceat(points, starts)
    middles, half_widths = 0.5 * (low + high), 0.5 * (high - low)
    ways, of = points[starts + sizes - 1] - points[starts], np.repeat(np.arange(len(parts)), sizes)
    squares = np.einsum("si,si->s", ways, ways)
    beyond = points - middles[of]
    along = np.einsum("pi,pi->p", beyond, ways[of]) / np.where(squares > 0.0, squares, 1.0)[of]
    reach = np.maximum.reduceat(np.abs(along), starts)
    off = np.maximum.reduceat(np.abs(beyond - along[:, None] * ways[of]), starts)
    return Chords(middles, half_widths, reach[:, None] * ways, off)
