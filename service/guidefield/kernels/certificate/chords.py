"""Boxes and straight ways about control points: see `prove.chords`."""

from __future__ import annotations

import numpy as np
from numba import void

from guidefield.kernels.jit.signatures import INDICES, MATRIX, MATRIX_OUT, Floats, Integers, lane_kernel


@lane_kernel(void(MATRIX, INDICES, MATRIX_OUT, MATRIX_OUT, MATRIX_OUT, MATRIX_OUT))
def find_chords(
    points: Floats, starts: Integers, middles: Floats, half_widths: Floats, chords: Floats, off: Floats
) -> None:
    """Find the box of each part's control points, the way along its first and last, and how far off this they are.

    Args:
        points: Control points of all parts, shape (p, nv) [rad or m].
        starts: Where each part's begin, and the number of all, shape (s + 1,).
        middles: Out: middles of the boxes, shape (s, nv) [rad or m].
        half_widths: Out: their half widths.
        chords: Out: half of each way.
        off: Out: how far the points are off the way through the middle.
    """
    nv = points.shape[1]
    for s in range(starts.shape[0] - 1):
        first, past = starts[s], starts[s + 1]
        square = 0.0
        for i in range(nv):
            low, high = np.inf, -np.inf
            for k in range(first, past):
                low, high = min(low, points[k, i]), max(high, points[k, i])
            middles[s, i], half_widths[s, i] = 0.5 * (low + high), 0.5 * (high - low)
            chords[s, i] = points[past - 1, i] - points[first, i]
            square += chords[s, i] * chords[s, i]
            off[s, i] = 0.0
        reach = 0.0
        for k in range(first, past):
            along = 0.0
            for i in range(nv):
                along += (points[k, i] - middles[s, i]) * chords[s, i]
            along /= square if square > 0.0 else 1.0
            reach = max(reach, abs(along))
            for i in range(nv):
                off[s, i] = max(off[s, i], abs(points[k, i] - middles[s, i] - along * chords[s, i]))
        for i in range(nv):
            chords[s, i] *= reach
