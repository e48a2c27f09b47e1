"""Halves of Bezier curves by de Casteljau's scheme, and the ranges of their control points."""

from __future__ import annotations

from numba import void

from guidefield.kernels.jit.signatures import BLOCKS, BLOCKS_OUT, MATRIX_OUT, Floats, lane_kernel


@lane_kernel(void(BLOCKS, BLOCKS_OUT))
def find_halves(curves: Floats, halves: Floats) -> None:
    """Find both halves of each curve, in order.

    Args:
        curves: Control points, shape (n, k, nv).
        halves: Out: theirs, shape (2 n, k, nv).
    """
    count, order, nv = curves.shape
    for curve in range(count):
        first, second = halves[2 * curve], halves[2 * curve + 1]
        for at in range(order):
            for i in range(nv):
                second[at, i] = curves[curve, at, i]
        for step in range(order):
            for i in range(nv):
                first[step, i] = second[0, i]
            for at in range(order - 1 - step):  # what is behind them is the second half already
                for i in range(nv):
                    second[at, i] = 0.5 * (second[at, i] + second[at + 1, i])


@lane_kernel(void(BLOCKS, MATRIX_OUT, MATRIX_OUT))
def find_ranges(curves: Floats, low: Floats, high: Floats) -> None:
    """Find the least and the largest value of each coordinate of each curve's control points.

    Args:
        curves: Control points, shape (n, k, nv).
        low: Out: shape (n, nv).
        high: Out: shape (n, nv).
    """
    count, order, nv = curves.shape
    for curve in range(count):
        for i in range(nv):
            low[curve, i] = high[curve, i] = curves[curve, 0, i]
        for at in range(1, order):
            for i in range(nv):
                low[curve, i] = min(low[curve, i], curves[curve, at, i])
                high[curve, i] = max(high[curve, i], curves[curve, at, i])
