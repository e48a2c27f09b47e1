"""Solution of a symmetric, positive definite system: on one thread, with the same last digits on every run.

The linear algebra that numpy comes with starts threads for systems of a hundred rows, which then wait for each other
longer than they compute.
"""

from __future__ import annotations

import math

from numba import types

from guidefield.kernels.signatures import MATRIX, MATRIX_OUT, Floats, compiled


@compiled(types.boolean(MATRIX_OUT))
def factorize(block_out: Floats) -> bool:
    """Replace the lower triangle of a symmetric matrix, shape (n, n), by its factor L with M = L L^T.

    Returns:
        Whether the matrix is positive definite; else what is left of it has no meaning.
    """
    n = block_out.shape[0]
    for j in range(n):
        pivot = block_out[j, j]
        for k in range(j):
            pivot -= block_out[j, k] * block_out[j, k]
        if not pivot > 0.0:
            return False
        pivot = math.sqrt(pivot)
        block_out[j, j] = pivot
        for i in range(j + 1, n):
            value = block_out[i, j]
            for k in range(j):
                value -= block_out[i, k] * block_out[j, k]
            block_out[i, j] = value / pivot
    return True


@compiled(types.boolean(MATRIX, MATRIX, MATRIX_OUT))
def solve_definite(matrix: Floats, right: Floats, solution_out: Floats) -> bool:
    """Solve M X = B by Cholesky's factors M = L L^T.

    Args:
        matrix: Symmetric, of which the lower triangle is read, shape (n, n).
        right: Right sides, shape (n, m).
        solution_out: Shape (n, m).

    Returns:
        Whether the matrix is positive definite; else `solution_out` has no meaning.
    """
    n, m = right.shape
    L = matrix.copy()
    if not factorize(L):
        return False
    for i in range(n):
        for c in range(m):
            value = right[i, c]
            for k in range(i):
                value -= L[i, k] * solution_out[k, c]
            solution_out[i, c] = value / L[i, i]
    for i in range(n - 1, -1, -1):
        for c in range(m):
            value = solution_out[i, c]
            for k in range(i + 1, n):
                value -= L[k, i] * solution_out[k, c]
            solution_out[i, c] = value / L[i, i]
    return True
