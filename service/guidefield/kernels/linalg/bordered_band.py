"""Solution of a symmetric, positive definite, banded system with one or two more rows, by a banded Cholesky factor.

The band consists of blocks: block row f has blocks f - 3 to f. With A = U^T U the border (B, C) adds the Schur
complement C - B^T A^{-1} B. The work is linear in the number of blocks (Golub and Van Loan, Matrix Computations, 2013,
section 4.3).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import types

from guidefield.kernels.jit.fields import RowOut, RowsOut, numba_type
from guidefield.kernels.jit.no_refcount import uncounted
from guidefield.kernels.jit.signatures import BLOCKS, MATRIX, SCALAR, VECTOR, Floats, compiled
from guidefield.kernels.simd.vector import LANES_64, load, store

COUPLED = 3
"""A block is coupled with as many before it."""

AT_ONCE = 4
"""Pivots whose rows are taken from the rest together: each number of it is then loaded and stored once for all."""

PANEL = 8 * AT_ONCE
"""Pivots that are taken from the rest while a few rows of it are in the fastest memory; a band is larger than that."""


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
    for first in range(0, rows, PANEL):
        last = min(first + PANEL, rows)
        for i in range(first, last, AT_ONCE):
            for t in range(min(AT_ONCE, rows - i)):
                for b in range(t):
                    _take(band[i + t][: width - t + b], band[i + b][t - b], band[i + b][t - b :])
                if not _eliminated(band[i + t]):
                    return False
            for k in range(i + AT_ONCE, min(last, i + width)):
                _take_pivots(band, i, k)
        for k in range(last, min(rows, last + width), AT_ONCE):
            for i in range(first, last, AT_ONCE):
                if k + AT_ONCE <= min(rows, i + width):
                    _take_pivots_of_some(band, i, k)
                else:
                    for row in range(k, min(rows, i + width)):
                        _take_pivots(band, i, row)
    return True


@uncounted
def _take_pivots(band: Floats, i: int, k: int) -> None:
    """Take the rows of the `AT_ONCE` pivots from i on from row k, if they are coupled: a vector loop."""
    row = band[k][: band.shape[1] - (k - i)]
    a, b, c, d = band[i][k - i :], band[i + 1][k - i - 1 :], band[i + 2][k - i - 2 :], band[i + 3][k - i - 3 :]
    if _uncoupled(a, b, c, d, 1):
        return
    a0, b0, c0, d0 = a[0], b[0], c[0], d[0]
    for m in range(row.shape[0]):
        row[m] -= a0 * a[m] + b0 * b[m] + c0 * c[m] + d0 * d[m]


@uncounted
def _uncoupled(a: Floats, b: Floats, c: Floats, d: Floats, rows: int) -> bool:
    """Whether the first numbers of four pivots, for so many rows, are all zero."""
    zero = True
    for m in range(rows):
        zero &= a[m] == 0.0 and b[m] == 0.0 and c[m] == 0.0 and d[m] == 0.0
    return zero


@uncounted
def _take_pivots_of_some(band: Floats, i: int, k: int) -> None:
    """The same from the `AT_ONCE` rows from k on: what is loaded of pivots serves all of these.

    Far from obstacles nothing couples a motion's coordinates: most rows are left alone then.
    """
    count = band.shape[1] - (k + 3 - i)
    a, b, c, d = band[i][k - i :], band[i + 1][k - i - 1 :], band[i + 2][k - i - 2 :], band[i + 3][k - i - 3 :]
    if _uncoupled(a, b, c, d, AT_ONCE):
        return
    a0, b0, c0, d0 = a[0], b[0], c[0], d[0]
    a1, b1, c1, d1 = a[1], b[1], c[1], d[1]
    a2, b2, c2, d2 = a[2], b[2], c[2], d[2]
    a3, b3, c3, d3 = a[3], b[3], c[3], d[3]
    p, q, r, s = band[k], band[k + 1], band[k + 2], band[k + 3]
    p[0] -= a0 * a0 + b0 * b0 + c0 * c0 + d0 * d0
    p[1] -= a0 * a1 + b0 * b1 + c0 * c1 + d0 * d1
    p[2] -= a0 * a2 + b0 * b2 + c0 * c2 + d0 * d2
    q[0] -= a1 * a1 + b1 * b1 + c1 * c1 + d1 * d1
    q[1] -= a1 * a2 + b1 * b2 + c1 * c2 + d1 * d2
    r[0] -= a2 * a2 + b2 * b2 + c2 * c2 + d2 * d2
    whole = count - count % LANES_64
    for m in range(0, whole, LANES_64):
        x, y, z, w = load(a, m + 3), load(b, m + 3), load(c, m + 3), load(d, m + 3)
        store(p, m + 3, load(p, m + 3) - (a0 * x + b0 * y + c0 * z + d0 * w))
        store(q, m + 2, load(q, m + 2) - (a1 * x + b1 * y + c1 * z + d1 * w))
        store(r, m + 1, load(r, m + 1) - (a2 * x + b2 * y + c2 * z + d2 * w))
        store(s, m, load(s, m) - (a3 * x + b3 * y + c3 * z + d3 * w))
    for m in range(whole, count):
        xs, ys, zs, ws = a[m + 3], b[m + 3], c[m + 3], d[m + 3]
        p[m + 3] -= a0 * xs + b0 * ys + c0 * zs + d0 * ws
        q[m + 2] -= a1 * xs + b1 * ys + c1 * zs + d1 * ws
        r[m + 1] -= a2 * xs + b2 * ys + c2 * zs + d2 * ws
        s[m] -= a3 * xs + b3 * ys + c3 * zs + d3 * ws


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


class BorderedFactor(NamedTuple):
    """A system [[A, B], [B^T, C]] in factors, with k = 1 or 2 columns in B; of memory until it is made.

    Attributes:
        band: U of A = U^T U, as `_factorize` leaves it, shape (n m, 4 m + AT_ONCE - 1).
        border: B by its columns, shape (k, n m).
        across: A^-1 B by its columns, shape (k, n m).
        pivots: Of S = C - B^T A^-1 B: the first, the one that the first leaves of the second, and the share of the
            first row that is in the second; shape (3,).
    """

    band: RowsOut
    border: RowsOut
    across: RowsOut
    pivots: RowOut


FACTOR = numba_type(BorderedFactor)


def room_for_factor(n: int, size: int, more: int) -> BorderedFactor:
    """Memory for n blocks of a size, and one or two more rows."""
    rows = n * size
    band = np.empty((rows, (COUPLED + 1) * size + AT_ONCE - 1))
    return BorderedFactor(band, np.empty((more, rows)), np.empty((more, rows)), np.zeros(3))


@compiled(types.boolean(BLOCKS, MATRIX, MATRIX, SCALAR, FACTOR))
def factorize_bordered(
    blocks: Floats, border: Floats, corner: Floats, damping: float, factor_out: BorderedFactor
) -> bool:
    """Factorize [[A, B], [B^T, C]] with its diagonal multiplied by 1 + damping.

    Args:
        blocks: A; block row f = blocks[f], its blocks beside one another, shape (n, m, 4 m): the last is on the
            diagonal, the first couples it with f - 3.
        border: B by its columns, shape (k, n m).
        corner: C, shape (k, k).
        damping: Not negative.
        factor_out: The factors.

    Returns:
        Whether the system is positive definite; if not, the factors mean nothing.
    """
    _upper(blocks, damping, factor_out.band)
    if not _factorize(factor_out.band):
        return False
    more = border.shape[0]
    for e in range(more):
        factor_out.border[e] = border[e]
        factor_out.across[e] = border[e]
        _substitute(factor_out.band, factor_out.across[e])
    pivots = factor_out.pivots
    first: float = corner[0, 0] * (1.0 + damping) - _product(border[0], factor_out.across[0])
    pivots[0] = first
    if more == 1 or not first > 0.0:
        return first > 0.0
    between: float = corner[0, 1] - _product(border[0], factor_out.across[1])
    second = corner[1, 1] * (1.0 + damping) - _product(border[1], factor_out.across[1]) - between / first * between
    pivots[1], pivots[2] = second, between / first
    return bool(second > 0.0)


@uncounted
def _product(first: Floats, second: Floats) -> float:
    """The inner product of two rows."""
    total = 0.0
    for k in range(first.shape[0]):
        total += first[k] * second[k]
    return total


@compiled(types.void(FACTOR, VECTOR, types.Array(types.float64, 1, "C")))
def solve_factorized(factor: BorderedFactor, right: Floats, solution_out: Floats) -> None:
    """Solve a system in factors for a right side; both have what belongs to the border last, shape (n m + k,)."""
    more, rows = factor.border.shape
    x = solution_out[:rows]
    x[:] = right[:rows]
    _substitute(factor.band, x)
    first = right[rows] - _product(factor.border[0], x)
    if more > 1:
        second = right[rows + 1] - _product(factor.border[1], x) - factor.pivots[2] * first
        second /= factor.pivots[1]
        solution_out[rows + 1] = second
        first -= factor.pivots[2] * factor.pivots[0] * second
        for i in range(rows):
            x[i] -= second * factor.across[1, i]
    first /= factor.pivots[0]
    solution_out[rows] = first
    for i in range(rows):
        x[i] -= first * factor.across[0, i]
