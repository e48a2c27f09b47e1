"""Solution of a symmetric, positive definite, banded system with one or two more rows, by a banded Cholesky factor.

The band consists of blocks: block row f has blocks f - 3 to f. With A = U^T U the border (B, C) adds the Schur
complement C - B^T A^{-1} B. The work is linear in the number of blocks (Golub and Van Loan, Matrix Computations, 2013,
section 4.3).

Blocks are made a multiple of `TILE` large, by rows of the identity. Block row f of U, its blocks f to f + 3 side by
side, is stored by strips of `TILE` columns, each row by row: a row of a tile is one vector, and nothing is left over.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import types

from guidefield.kernels.jit.fields import BlocksOut, IndexBlocksOut, RowOut, RowsOut, numba_type
from guidefield.kernels.jit.no_refcount import uncounted
from guidefield.kernels.jit.signatures import BLOCKS, MATRIX, SCALAR, VECTOR, Floats, Integers, compiled
from guidefield.kernels.simd.vector import LANES_64, load, magnitude, store, total

COUPLED = 3
"""A block is coupled with as many before it."""

TILE = LANES_64
"""Rows and columns of a tile."""

FIRST, PAST = 0, 1
"""Columns of a strip's rows that aren't zero."""


@uncounted
def _fill(blocks: Floats, damping: float, strips_out: Floats) -> None:
    """The upper triangle of a matrix, with whole blocks on its diagonal, which is multiplied by 1 + damping."""
    n, size, _ = blocks.shape
    per_block = strips_out.shape[1] // (COUPLED + 1)
    for f in range(n):
        for j in range(COUPLED + 1):
            for t in range(per_block):
                strip, columns = strips_out[f, j * per_block + t], max(min(TILE, size - TILE * t), 0)
                strip[:] = 0.0
                if f + j < n:
                    source = blocks[f + j, TILE * t : TILE * t + columns, (COUPLED - j) * size :]
                    for p in range(size):
                        for c in range(columns):
                            strip[p * TILE + c] = source[c, p]
        for p in range(per_block * TILE):
            diagonal = strips_out[f, p // TILE][p * TILE + p % TILE :]
            diagonal[0] = diagonal[0] * (1.0 + damping) if p < size else 1.0


@uncounted
def _take_product(a: Floats, b: Floats, rows: int, c: Floats) -> None:
    """Subtract a^T b from a tile c, of two strips of so many rows."""
    c0, c1, c2, c3 = load(c, 0), load(c, TILE), load(c, 2 * TILE), load(c, 3 * TILE)
    c4, c5, c6, c7 = load(c, 4 * TILE), load(c, 5 * TILE), load(c, 6 * TILE), load(c, 7 * TILE)
    for k in range(rows):
        at = k * TILE
        row = load(b, at)
        c0 -= a[at] * row
        c1 -= a[at + 1] * row
        c2 -= a[at + 2] * row
        c3 -= a[at + 3] * row
        c4 -= a[at + 4] * row
        c5 -= a[at + 5] * row
        c6 -= a[at + 6] * row
        c7 -= a[at + 7] * row
    store(c, 0, c0)
    store(c, TILE, c1)
    store(c, 2 * TILE, c2)
    store(c, 3 * TILE, c3)
    store(c, 4 * TILE, c4)
    store(c, 5 * TILE, c5)
    store(c, 6 * TILE, c6)
    store(c, 7 * TILE, c7)


@uncounted
def _take_strips(a: Floats, of_a: Integers, b: Floats, of_b: Integers, most: int, c: Floats) -> None:
    """The same of the rows before `most` in which neither strip is zero; where they aren't is given for both."""
    first, past = max(of_a[FIRST], of_b[FIRST]), min(of_a[PAST], of_b[PAST], most)
    if first < past:
        _take_product(a[first * TILE :], b[first * TILE :], past - first, c)


@uncounted
def _factorize_tile(tile: Floats) -> bool:
    """Replace a tile on the diagonal by its factor, zeros below; whether it is positive definite."""
    for i in range(TILE):
        row = tile[i * TILE : (i + 1) * TILE]
        for k in range(i):
            share = tile[k * TILE + i]
            for c in range(TILE):
                row[c] -= share * tile[k * TILE + c]
        if not row[i] > 0.0:
            return False
        scale = 1.0 / math.sqrt(row[i])
        for c in range(TILE):
            row[c] = scale * row[c] if c >= i else 0.0
    return True


@uncounted
def _solve_tile(tile: Floats, c: Floats) -> bool:
    """Replace a tile c by U^-T c, U a factor on the diagonal; whether anything in it isn't zero."""
    amount = 0.0 * load(c, 0)
    for i in range(TILE):
        row = load(c, i * TILE)
        for k in range(i):
            row -= tile[k * TILE + i] * load(c, k * TILE)
        row = row / tile[i * TILE + i]
        amount += magnitude(row)
        store(c, i * TILE, row)
    return bool(total(amount) != 0.0)


@uncounted
def _factorize(size: int, strips: Floats, spans: Integers) -> bool:
    """Replace a matrix A by its factor U, A = U^T U.

    Args:
        size: Rows of its blocks, without those of the identity.
        strips: As `_fill` leaves them, shape (n, strips, rows `TILE`).
        spans: Gets where each strip isn't zero, shape (n, strips, 2).

    Returns:
        Whether the matrix is positive definite; if not, the strips mean nothing.
    """
    n, count, _ = strips.shape
    per_block = count // (COUPLED + 1)
    for f in range(n):
        for s in range(count):  # what blocks before take away: the strip stays in the fastest memory meanwhile
            for g in range(max(f - COUPLED, 0), f):
                column = (f - g) * per_block + s
                if column >= count:
                    continue
                of_column, column_spans = strips[g, column], spans[g, column]
                for t in range(min(s + 1, per_block)):
                    row = (f - g) * per_block + t
                    tile = strips[f, s][t * TILE * TILE :]
                    _take_strips(strips[g, row], spans[g, row], of_column, column_spans, size, tile)
        spans[f, :, FIRST], spans[f, :, PAST] = size, 0
        for t in range(per_block):
            diagonal = strips[f, t][t * TILE * TILE :]
            _take_strips(strips[f, t], spans[f, t], strips[f, t], spans[f, t], t * TILE, diagonal)
            if not _factorize_tile(diagonal):
                return False
            for s in range(t + 1, count):
                tile = strips[f, s][t * TILE * TILE :]
                _take_strips(strips[f, t], spans[f, t], strips[f, s], spans[f, s], t * TILE, tile)
                if _solve_tile(diagonal, tile):
                    spans[f, s, FIRST] = min(spans[f, s, FIRST], t * TILE)
                    spans[f, s, PAST] = min((t + 1) * TILE, size)
    return True


@uncounted
def _substitute(strips: Floats, right: Floats) -> None:
    """Replace b by (U^T U)^{-1} b; b has the rows of the identity, and those of three more blocks, which are zero."""
    n, count, _ = strips.shape
    per_block = count // (COUPLED + 1)
    for f in range(n):
        for t in range(per_block):
            x = right[(f * per_block + t) * TILE :]
            diagonal = strips[f, t][t * TILE * TILE :]
            for i in range(TILE):
                for k in range(i):
                    x[i] -= diagonal[k * TILE + i] * x[k]
                x[i] /= diagonal[i * TILE + i]
            for s in range(t + 1, count):
                tile, at = strips[f, s][t * TILE * TILE :], (s - t) * TILE
                row = load(x, at)
                for k in range(TILE):
                    row -= x[k] * load(tile, k * TILE)
                store(x, at, row)
    for f in range(n - 1, -1, -1):
        for t in range(per_block - 1, -1, -1):
            x = right[(f * per_block + t) * TILE :]
            diagonal = strips[f, t][t * TILE * TILE :]
            for i in range(TILE - 1, -1, -1):
                amount = 0.0 * load(x, 0)
                for s in range(t + 1, count):
                    amount += load(strips[f, s], (t * TILE + i) * TILE) * load(x, (s - t) * TILE)
                value = x[i] - total(amount)
                for k in range(i + 1, TILE):
                    value -= diagonal[i * TILE + k] * x[k]
                x[i] = value / diagonal[i * TILE + i]


class BorderedFactor(NamedTuple):
    """A system [[A, B], [B^T, C]] in factors, with k = 1 or 2 columns in B; of memory until it is made.

    Attributes:
        strips: U of A = U^T U, as `_factorize` leaves it.
        spans: Where its strips aren't zero.
        padded: Memory for a right side with the rows of the identity, and three more blocks.
        border: B by its columns, shape (k, n m).
        across: A^-1 B by its columns, shape (k, n m).
        pivots: Of S = C - B^T A^-1 B: the first, the one that the first leaves of the second, and the share of the
            first row that is in the second; shape (3,).
    """

    strips: BlocksOut
    spans: IndexBlocksOut
    padded: RowOut
    border: RowsOut
    across: RowsOut
    pivots: RowOut


FACTOR = numba_type(BorderedFactor)


def room_for_factor(n: int, size: int, more: int) -> BorderedFactor:
    """Memory for n blocks of a size, and one or two more rows."""
    per_block = -(-size // TILE)
    count, padded = (COUPLED + 1) * per_block, per_block * TILE
    return BorderedFactor(
        np.empty((n, count, padded * TILE)),
        np.empty((n, count, 2), np.int64),
        np.zeros((n + COUPLED) * padded),
        np.empty((more, n * size)),
        np.empty((more, n * size)),
        np.zeros(3),
    )


@uncounted
def _solve_band(factor: BorderedFactor, size: int, right_out: Floats) -> None:
    """Replace b, shape (n m,), by A^{-1} b."""
    n, padded = factor.strips.shape[0], factor.strips.shape[1] // (COUPLED + 1) * TILE
    x = factor.padded
    x[:] = 0.0
    for f in range(n):
        for p in range(size):
            x[f * padded + p] = right_out[f * size + p]
    _substitute(factor.strips, x)
    for f in range(n):
        for p in range(size):
            right_out[f * size + p] = x[f * padded + p]


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
    size = blocks.shape[1]
    _fill(blocks, damping, factor_out.strips)
    if not _factorize(size, factor_out.strips, factor_out.spans):
        return False
    more = border.shape[0]
    for e in range(more):
        factor_out.border[e] = border[e]
        factor_out.across[e] = border[e]
        _solve_band(factor_out, size, factor_out.across[e])
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
    _solve_band(factor, rows // factor.strips.shape[0], x)
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
