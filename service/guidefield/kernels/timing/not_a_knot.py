"""Slopes of the C² cubic spline through samples whose ends go on as the pieces next to them: one tridiagonal solve."""

from __future__ import annotations

from numba import void

from guidefield.kernels.jit.signatures import MATRIX, MATRIX_OUT, VECTOR, VECTOR_OUT, Floats, compiled


@compiled(void(VECTOR, MATRIX, VECTOR_OUT, VECTOR_OUT, MATRIX_OUT))
def slopes(steps: Floats, values: Floats, pivots_out: Floats, above_out: Floats, slopes_out: Floats) -> None:
    """First derivatives s at the knots of the C² piecewise cubic through values, "not a knot" at its ends.

    The two first pieces are one cubic, and so are the two last ones. Continuity of the second derivative at inner knot
    i, with chords d_i = (y_{i+1} - y_i) / h_i, is

        h_i s_{i-1} + 2 (h_{i-1} + h_i) s_i + h_{i-1} s_{i+1} = 3 (h_i d_{i-1} + h_{i-1} d_i)

    and continuity of the third one at knot 1 makes the first row, with w = h_0 + h_1,

        h_1 s_0 + w s_1 = ((h_0 + 2 w) h_1 d_0 + h_0² d_1) / w

    and the last row its mirror image (de Boor, A Practical Guide to Splines, 2001, chapter IV). After the first row is
    eliminated the system is diagonally dominant but for the last row, whose pivot stays positive: no pivoting.

    Args:
        steps: Differences h between knots, shape (n - 1,), n >= 4, positive.
        values: Values y at the knots, shape (n, c).
        pivots_out: Work space, shape (n,).
        above_out: Work space, shape (n,).
        slopes_out: The result s, shape (n, c).
    """
    last = steps.shape[0]
    h0, h1 = steps[0], steps[1]
    wide = h0 + h1
    pivots_out[0], above_out[0] = h1, wide
    for c in range(values.shape[1]):
        first, second = (values[1, c] - values[0, c]) / h0, (values[2, c] - values[1, c]) / h1
        slopes_out[0, c] = ((h0 + 2.0 * wide) * h1 * first + h0 * h0 * second) / wide
    for i in range(1, last):
        before, after = steps[i - 1], steps[i]
        ratio = after / pivots_out[i - 1]
        pivots_out[i], above_out[i] = 2.0 * (before + after) - ratio * above_out[i - 1], before
        for c in range(values.shape[1]):
            first, second = (values[i, c] - values[i - 1, c]) / before, (values[i + 1, c] - values[i, c]) / after
            slopes_out[i, c] = 3.0 * (after * first + before * second) - ratio * slopes_out[i - 1, c]
    h0, h1 = steps[last - 1], steps[last - 2]
    wide = h0 + h1
    ratio = wide / pivots_out[last - 1]
    pivots_out[last] = h1 - ratio * above_out[last - 1]
    for c in range(values.shape[1]):
        first, second = (values[last, c] - values[last - 1, c]) / h0, (values[last - 1, c] - values[last - 2, c]) / h1
        right = ((h0 + 2.0 * wide) * h1 * first + h0 * h0 * second) / wide
        slopes_out[last, c] = (right - ratio * slopes_out[last - 1, c]) / pivots_out[last]
    for i in range(last - 1, -1, -1):
        for c in range(values.shape[1]):
            slopes_out[i, c] = (slopes_out[i, c] - above_out[i] * slopes_out[i + 1, c]) / pivots_out[i]
