"""Where the control points of curves lie: in a box, and near a straight way through its middle.

A curve is a convex combination of its control points. So it stays in the box of them; and it stays off a straight way
by no more, in each coordinate, than the one of them that is farthest off.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate
from typing import Any, NamedTuple, cast

import numpy as np

from guidefield.kernels.certificate.chords import find_chords
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
    starts = np.array([0, *accumulate(part.shape[0] * part.shape[1] for part in parts)])
    points = np.concatenate(parts, axis=None).reshape(starts[-1], parts[0].shape[2])
    found = Chords(*(cast(Any, np.empty((len(parts), points.shape[1]))) for _ in Chords._fields))
    find_chords(points, starts, *found)
    return found
