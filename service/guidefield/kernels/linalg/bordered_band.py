"""Solution of a symmetric, positive definite, banded system with one more row and column, by a banded Cholesky factor.

The band consists of blocks: block row f has blocks f - 3 to f. With A = L L^T the border (b, c) adds the scalar Schur
complement c - b^T A^{-1} b. The work is linear in the number of blocks (Golub and Van Loan, Matrix Computations, 2013,
section 4.3).
"""

from __future__ import annotations

import math

from numba import types

from guidefield.kernels.jit.signatures import BLOCKS, MATRIX_OUT, SCALAR, VECTOR, Floats, compiled, inlined

COUPLED = 3
"""A block is coupled with as many before it."""


@inlined
def _dot(first: Floats, second: Floats) -> float:
    """Inner product of two rows as long as the first: a vector loop."""
    total = 0.0
    for k in range(first.shape[0]):
        total += first[k] * second[k]
    return total


@compiled(types.boolean(MATRIX_OUT, types.int64))
def factorize(band_out: Floats, size: int) -> bool:
    """Replace a banded matrix by its Cholesky factor.

    Args:
        band_out: Row r, of block row f = r // size, holds the columns from (f - `COUPLED`) size on, shape
            (n size, (`COUPLED` + 1) size); only what is at or below the diagonal counts.
        size: Of a block.

    Returns:
        Whether the matrix is positive definite; if not, `band_out` means nothing.
    """
    rows = band_out.shape[0]
    for i in range(rows):
        f = i // size
        base = (f - COUPLED) * size
        row = band_out[i]
        for j in range(max(base, 0), i):
            shift = (f - j // size) * size
            first = max(base, 0) - base
            past = j - base
            value = row[past] - _dot(row[first:past], band_out[j][first + shift : past + shift])
            row[past] = value / band_out[j, past + shift]
        first, past = max(base, 0) - base, i - base
        pivot = row[past] - _dot(row[first:past], row[first:past])
        if not pivot > 0.0:
            return False
        row[past] = math.sqrt(pivot)
    return True


@inlined
def _substitute(band: Floats, size: int, right_out: Floats) -> None:
    """Replace b (n size,) by (L L^T)^{-1} b."""
    rows = band.shape[0]
    for i in range(rows):
        base = (i // size - COUPLED) * size
        first = max(base, 0)
        right_out[i] = (right_out[i] - _dot(right_out[first:i], band[i][first - base : i - base])) / band[i][i - base]
    for i in range(rows - 1, -1, -1):
        base = (i // size - COUPLED) * size
        value = right_out[i] / band[i][i - base]
        right_out[i] = value
        for k in range(max(base, 0), i):
            right_out[k] -= value * band[i][k - base]


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
    band = blocks.copy().reshape(rows, width)
    for i in range(rows):
        band[i, COUPLED * size + i % size] *= 1.0 + damping
    if not factorize(band, size):
        return False
    x, across = right.copy(), border.copy()
    _substitute(band, size, x)
    _substitute(band, size, across)
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
