"""Second derivatives of a natural cubic spline at its knots: one tridiagonal solve for all coordinates at once."""

from __future__ import annotations

from numba import void

from guidefield.kernels.jit.signatures import MATRIX, MATRIX_OUT, VECTOR, VECTOR_OUT, Floats, compiled


@compiled(void(VECTOR, MATRIX, VECTOR_OUT, MATRIX_OUT))
def second_derivatives(steps: Floats, values: Floats, pivots_out: Floats, second_out: Floats) -> None:
    """Second derivatives M of the C² piecewise cubic through values, with M = 0 at both ends.

    Continuity of the first derivative at inner knot i, with chords d_i = (y_{i+1} - y_i) / h_i, is

        h_{i-1} M_{i-1} + 2 (h_{i-1} + h_i) M_i + h_i M_{i+1} = 6 (d_i - d_{i-1})

    a diagonally dominant system, so that elimination needs no pivoting (Thomas' algorithm).

    Args:
        steps: Differences h between knots, shape (n - 1,), positive.
        values: Values y at the knots, shape (n, c).
        pivots_out: Work space, shape (n,).
        second_out: The result M, shape (n, c).
    """
    last = steps.shape[0]
    second_out[0] = 0.0
    second_out[last] = 0.0
    for i in range(1, last):
        # row i - 1 was divided by its pivot; the first row has the known M_0 = 0 before it
        ratio = steps[i - 1] / pivots_out[i - 1] if i > 1 else 0.0
        pivots_out[i] = 2.0 * (steps[i - 1] + steps[i]) - ratio * steps[i - 1]
        for c in range(values.shape[1]):
            bend = (values[i + 1, c] - values[i, c]) / steps[i] - (values[i, c] - values[i - 1, c]) / steps[i - 1]
            second_out[i, c] = 6.0 * bend - ratio * second_out[i - 1, c]
    for i in range(last - 1, 0, -1):
        for c in range(values.shape[1]):
            second_out[i, c] = (second_out[i, c] - steps[i] * second_out[i + 1, c]) / pivots_out[i]
