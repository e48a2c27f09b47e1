"""Lengths of the parts of a way by chords, and how far a motion may go back and forth within them."""

from __future__ import annotations

import math

from numba import void

from guidefield.kernels.jit.signatures import BLOCKS, MATRIX, MATRIX_OUT, VECTOR_OUT, Floats, compiled

STRIDES = 3
"""Each part is measured by all of its chords, by every second and by every fourth of its points."""


@compiled(void(BLOCKS, MATRIX_OUT))
def chord_lengths(points: Floats, lengths_out: Floats) -> None:
    """Lengths of polylines, and of those through every second and every fourth point.

    Args:
        points: One more than a multiple of four of each, shape (n, k, d).
        lengths_out: Shape (n, STRIDES).
    """
    for n in range(points.shape[0]):
        stride = 1
        for level in range(STRIDES):
            total = 0.0
            for k in range(stride, points.shape[1], stride):
                square = 0.0
                for d in range(points.shape[2]):
                    square += (points[n, k, d] - points[n, k - stride, d]) ** 2
                total += math.sqrt(square)
            lengths_out[n, level] = total
            stride *= 2


@compiled(void(MATRIX, BLOCKS, BLOCKS, VECTOR_OUT))
def against_chords(times: Floats, points: Floats, rates: Floats, found_out: Floats) -> None:
    """How far motions may go back and forth within their chords: each chord that they go against at an end counts.

    Args:
        times: Of the ends of chords, evenly, shape (n, k) [s].
        points: Chart points there, shape (n, k, nv) [rad or m].
        rates: Velocities there, shape (n, k, nv).
        found_out: Shape (n,) [rad or m].
    """
    for n in range(points.shape[0]):
        total = 0.0
        for k in range(points.shape[1] - 1):
            for end in range(2):
                along, square = 0.0, 0.0
                for j in range(points.shape[2]):
                    rate = rates[n, k + end, j]
                    along += rate * (points[n, k + 1, j] - points[n, k, j])
                    square += rate * rate
                total += math.sqrt(square) if along < 0.0 else 0.0
        found_out[n] = total * (times[n, 1] - times[n, 0])
