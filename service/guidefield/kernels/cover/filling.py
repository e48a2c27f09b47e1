"""Balls chosen one after the other, each the one that holds most of the points that those before don't."""

from __future__ import annotations

import numpy as np
from numba import types, uint64, void

from guidefield.kernels.cover.ball_cover import WORDS_OUT
from guidefield.kernels.cover.greedy_set_cover import WORDS, ones
from guidefield.kernels.jit.signatures import INDICES_OUT, MATRIX, Floats, Integers, compiled

_MISSING = types.Array(types.uint64, 1, "C", readonly=True)


@compiled(void(MATRIX, MATRIX, WORDS_OUT))
def held_points(balls: Floats, points: Floats, bits_out: np.ndarray) -> None:
    """Find which ball holds which point.

    Args:
        balls: Centre and radius, shape (n, 4) [m].
        points: Shape (m, 3) [m], in the same frame.
        bits_out: Shape (n, words); gets bit j of row i set if ball i holds point j, no other.
    """
    count = points.shape[0]
    x, y, z = points[:, 0].copy(), points[:, 1].copy(), points[:, 2].copy()
    for i in range(balls.shape[0]):
        square = balls[i, 3] * balls[i, 3]
        for w in range(bits_out.shape[1]):
            word = uint64(0)
            for j in range(64 * w, min(64 * (w + 1), count)):
                dx, dy, dz = x[j] - balls[i, 0], y[j] - balls[i, 1], z[j] - balls[i, 2]
                word |= uint64(dx * dx + dy * dy + dz * dz <= square) << uint64(j & 63)
            bits_out[i, w] = word


@compiled(void(WORDS, _MISSING, INDICES_OUT))
def count_missing(bits: np.ndarray, missing: np.ndarray, counts_out: Integers) -> None:
    """Count how many of the points that are missing each ball holds.

    Args:
        bits: Which ball holds which point, shape (n, words).
        missing: Which points are, shape (words,).
        counts_out: Gets the counts, shape (n,).
    """
    for i in range(bits.shape[0]):
        count = 0
        for w in range(bits.shape[1]):
            count += ones(bits[i, w] & missing[w])
        counts_out[i] = count
