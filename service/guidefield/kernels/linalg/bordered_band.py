"""Solution of a symmetric, positive definite, banded system with one more row and column, by a banded Cholesky factor.

The band consists of blocks: block row f has blocks f - 3 to f. With A = U^T U the border (b, c) adds the scalar Schur
complement c - b^T A^{-1} b. The work is linear in the number of blocks (Golub and Van Loan, Matrix Computations, 2013,
section 4.3).
"""

from __future__ import annotations

import math

import numpy as np
from numba import types

from guidefield.kernels.jit.no_refcount import uncounted
from guidefield.kernels.jit.signatures import BLOCKS, SCALAR, VECTOR, Floats, compiled

COUPLED = 3
"""A block is coupled with as many before it."""

AT_ONCE = 4
"""Pivots whose rows are taken from the rest together: each number of it is then loaded and stored once for all."""


@uncounted
def _upper(blocks: Floats, damping: float, band_out: Floats) -> None:
    """Rows of the upper triangle, each from its diagonal on, which is multiplied by 1 + damping; zeros behind them."""
    n, size, width = blocks.shape
    band_out[:, :] = 0.0
    for f in range(n):
        for q in range(size):
            for c in range(max(COUPLED - f, 0), COUPLED):
                back = (COUPLED - c) * size
                for p in range(size):
                    band_out[f * size - back + p, back + q - p] = blocks[f, q, c * size + p]
            row, diagonal = band_out[f * size + q], blocks[f, q, width - size + q :]
            for k in range(size - q):
                row[k] = diagonal[k]
            row[0] *= 1.0 + damping


@uncounted
def _eliminated(row: Floats) -> bool:
    """Divide a row by the root of its pivot, with which it begins; whether that is positive."""
    if not row[0] > 0.0:
        return False
    scale = 1.0 / math.sqrt(row[0])
    for k in range(row.shape[0]):
        row[k] *= scale
    return True


@uncounted
def _factorize(band: Floats) -> bool:
    """Replace a matrix A by its factor U, A = U^T U.

    Args:
        band: Row i holds the columns from i on; behind them are `AT_ONCE` - 1 zeros; shape (rows, w + `AT_ONCE` - 1).

    Returns:
        Whether the matrix is positive definite; if not, `band` means nothing.
    """
    rows, width = band.shape
    for i in range(0, rows, AT_ONCE):
        for t in range(min(AT_ONCE, rows - i)):
            for b in range(t):
                _take(band[i + t][: width - t + b], band[i + b][t - b], band[i + b][t - b :])
            if not _eliminated(band[i + t]):
                return False
        if i + AT_ONCE > rows:
            break
        first, second, third, fourth = band[i], band[i + 1], band[i + 2], band[i + 3]
        for k in range(AT_ONCE, min(rows - i, width)):
            row = band[i + k][: width - k]
            a, b, c, d = first[k:], second[k - 1 :], third[k - 2 :], fourth[k - 3 :]
            a0, b0, c0, d0 = a[0], b[0], c[0], d[0]
            for m in range(row.shape[0]):
                row[m] -= a0 * a[m] + b0 * b[m] + c0 * c[m] + d0 * d[m]
    return True


@uncounted
def _take(row: Floats, share: float, other: Floats) -> None:
    """Subtract a multiple of another row: a vector loop."""
    for k in range(row.shape[0]):
        row[k] -= share * other[k]


@uncounted
def _substitute(band: Floats, right_out: Floats) -> None:
    """Replace b (rows,) by (U^T U)^{-1} b."""
    rows, width = band.shape
    for i in range(rows):
        right_out[i] /= band[i, 0]
        behind = right_out[i + 1 : i + width]
        _take(behind, right_out[i], band[i, 1:])
    for i in range(rows - 1, -1, -1):
        row, behind = band[i, 1:], right_out[i + 1 : i + width]
        value = right_out[i]
        for k in range(behind.shape[0]):
            value -= row[k] * behind[k]
        right_out[i] = value / band[i, 0]


@compiled(types.boolean(BLOCKS, VECTOR, SCALAR, VECTOR, SCALAR, SCALAR, types.Array(types.float64, 1, "C")))
def solve_bordered(
    blocks: Floats,
    border: Floats,
    corner: float,
    right: Floats,
    right_corner: float,
    damping: float,
    solution_out: Floats,
) -> bool:
    """Solve [[A, b], [b^T, c]] (x, y) = (r, s), with A's diagonal multiplied by 1 + damping.

    Args:
        blocks: A; block row f = blocks[f], its blocks beside one another, shape (n, m, 4 m): the last is on the
            diagonal, the first couples it with f - 3.
        border: b, shape (n m,).
        corner: c.
        right: r, shape (n m,).
        right_corner: s.
        damping: Not negative.
        solution_out: x and behind it y, shape (n m + 1,).

    Returns:
        Whether the system is positive definite; if not, `solution_out` means nothing.
    """
    n, size, width = blocks.shape
    rows = n * size
    band = np.empty((rows, width + AT_ONCE - 1))
    _upper(blocks, damping, band)
    if not _factorize(band):
        return False
    x, across = right.copy(), border.copy()
    _substitute(band, x)
    _substitute(band, across)
    pivot, rest = corner * (1.0 + damping), right_corner
    for i in range(rows):
        pivot -= border[i] * across[i]
        rest -= border[i] * x[i]
    if not pivot > 0.0:
        return False
    y = rest / pivot
    for i in range(rows):
        solution_out[i] = x[i] - y * across[i]
    solution_out[rows] = y
    return True
