"""Between which values control points lie."""

from __future__ import annotations

from numba import void

from guidefield.kernels.jit.signatures import BLOCKS, MATRIX_OUT, Floats, lane_kernel


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
