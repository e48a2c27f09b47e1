"""Solution of a symmetric, positive definite, block-tridiagonal system by Cholesky factors of its blocks.

With A_k on the diagonal and U_k to the right of it, the factors are L_k L_k^T = A_k - B_k^T B_k and
B_{k+1} = L_k^{-1} U_k. The work is linear in the number of blocks.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types

from guidefield.kernels.jit.signatures import (
    BLOCKS,
    BLOCKS_OUT,
    MATRIX,
    MATRIX_OUT,
    VECTOR,
    VECTOR_OUT,
    Floats,
    compiled,
)


@compiled(types.boolean(MATRIX_OUT))
def _factorize(block_out: Floats) -> bool:
    """Replace a symmetric matrix, lower triangle, by its Cholesky factor; whether it is positive definite."""
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


@compiled(types.void(MATRIX_OUT, MATRIX_OUT, VECTOR_OUT, MATRIX_OUT, VECTOR_OUT))
def _eliminate(L: Floats, coupling_out: Floats, y: Floats, next_block_out: Floats, next_right_out: Floats) -> None:
    """Take a block with factor L and reduced right side y out of the next one; the coupling becomes B = L^{-1} U."""
    size = L.shape[0]
    for i in range(size):
        for j in range(size):
            value = coupling_out[i, j]
            for k in range(i):
                value -= L[i, k] * coupling_out[k, j]
            coupling_out[i, j] = value / L[i, i]
    for k in range(size):
        for i in range(size):
            next_right_out[i] -= coupling_out[k, i] * y[k]
            for j in range(i + 1):
                next_block_out[i, j] -= coupling_out[k, i] * coupling_out[k, j]


@compiled(types.void(BLOCKS, BLOCKS, MATRIX, MATRIX, VECTOR, BLOCKS_OUT, BLOCKS_OUT, MATRIX_OUT))
def _masked(
    diagonal: Floats,
    upper: Floats,
    right: Floats,
    free: Floats,
    damping: Floats,
    factors_out: Floats,
    couplings_out: Floats,
    solution_out: Floats,
) -> None:
    """The system with the damping added and the unknowns that aren't free cut out of it."""
    n, size = right.shape
    for k in range(n):
        for i in range(size):
            solution_out[k, i] = free[k, i] * right[k, i]
            for j in range(size):
                factors_out[k, i, j] = free[k, i] * free[k, j] * diagonal[k, i, j]
                if k > 0:
                    couplings_out[k - 1, i, j] = free[k - 1, i] * free[k, j] * upper[k - 1, i, j]
            factors_out[k, i, i] += damping[i] + (1.0 - free[k, i])


@compiled(types.boolean(BLOCKS, BLOCKS, MATRIX, MATRIX, VECTOR, MATRIX_OUT))
def solve_free(
    diagonal: Floats, upper: Floats, right: Floats, free: Floats, damping: Floats, solution_out: Floats
) -> bool:
    """Solve (A + damping) x = b for the unknowns that are free; the others stay 0.

    Args:
        diagonal: Blocks A_k, symmetric, shape (n, m, m).
        upper: Blocks U_k that couple k with k + 1, shape (n - 1, m, m).
        right: b, shape (n, m).
        free: 1 where an unknown is free, else 0, shape (n, m).
        damping: Added to the diagonal of every block, shape (m,).
        solution_out: x, shape (n, m).

    Returns:
        Whether the system is positive definite; if not, `solution_out` means nothing.
    """
    n, size = right.shape
    factors = np.empty(diagonal.shape)
    couplings = np.empty(upper.shape)
    _masked(diagonal, upper, right, free, damping, factors, couplings, solution_out)
    for k in range(n):
        L = factors[k]
        if k > 0:
            _eliminate(factors[k - 1], couplings[k - 1], solution_out[k - 1], L, solution_out[k])
        if not _factorize(L):
            return False
        for i in range(size):
            value = solution_out[k, i]
            for j in range(i):
                value -= L[i, j] * solution_out[k, j]
            solution_out[k, i] = value / L[i, i]
    for k in range(n - 1, -1, -1):
        L = factors[k]
        for i in range(size - 1, -1, -1):
            value = solution_out[k, i]
            if k + 1 < n:
                for j in range(size):
                    value -= couplings[k, i, j] * solution_out[k + 1, j]
            for j in range(i + 1, size):
                value -= L[j, i] * solution_out[k, j]
            solution_out[k, i] = value / L[i, i]
    return True
