"""Solution of a symmetric, positive definite, banded system with one or two more rows, by a banded Cholesky factor.

With A = U^T U the border (B, C) adds the Schur complement C - B^T A^{-1} B. Rows of A's blocks fall into groups one
after the other; those of different groups aren't coupled in any block, and each group has a factor of its own.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import types

from guidefield.kernels.jit.fields import IndicesOut, RowOut, RowsOut, numba_type
from guidefield.kernels.jit.no_refcount import counted, uncounted
from guidefield.kernels.jit.signatures import BLOCKS, INDICES, MATRIX, SCALAR, VECTOR, Floats, Integers, compiled
from guidefield.kernels.linalg.banded_cholesky import COUPLED, TILE, factorize, fill, substitute


class BorderedFactor(NamedTuple):
    """A system [[A, B], [B^T, C]] in factors, with k = 1 or 2 columns in B; of memory until it is made.

    Attributes:
        groups: Where each group of a block's rows begins, and where the last ends; behind that it means nothing.
        strips: U of A = U^T U, group by group as `factorize` leaves it.
        spans: Where its strips aren't zero.
        inverses: Of its tiles on the diagonal, transposed.
        padded: Memory for a group's right side with the rows of the identity, and three more blocks.
        border: B by its columns, shape (k, n m).
        across: A^-1 B by its columns, shape (k, n m).
        pivots: Of S = C - B^T A^-1 B: the first, the one that the first leaves of the second, and the share of the
            first row that is in the second; shape (3,).
    """

    groups: IndicesOut
    strips: RowOut
    spans: IndicesOut
    inverses: RowOut
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
        np.empty(per_block + 1, np.int64),
        np.empty(n * count * padded * TILE),
        np.empty(n * count * 2, np.int64),
        np.empty(n * per_block * TILE * TILE),
        np.zeros((n + COUPLED) * padded),
        np.empty((more, n * size)),
        np.empty((more, n * size)),
        np.zeros(3),
    )


@uncounted
def inner_product(first: Floats, second: Floats) -> float:
    """The inner product of two rows, shape (n,)."""
    total = 0.0
    for k in range(first.shape[0]):
        total += first[k] * second[k]
    return total


@counted
def _of_group(factor: BorderedFactor, n: int, first: int, size: int) -> tuple[Floats, Integers, Floats]:
    """Return where a group's strips, their spans and the inverses are kept: behind what those before it can take."""
    before, tiles, whole = first // TILE, -(-size // TILE), factor.groups.shape[0] - 1
    count, strip = (COUPLED + 1) * tiles, tiles * TILE * TILE
    at = n * (COUPLED + 1) * before * whole * TILE * TILE
    strips = factor.strips[at : at + n * count * strip].reshape((n, count, strip))
    at = 2 * n * (COUPLED + 1) * before
    spans = factor.spans[at : at + 2 * n * count].reshape((n, count, 2))
    at = n * before * TILE * TILE
    inverses = factor.inverses[at : at + n * strip].reshape((n, tiles, TILE * TILE))
    return strips, spans, inverses


@counted
def _solve_band(factor: BorderedFactor, n: int, right_out: Floats) -> None:
    """Replace b, shape (n m,), by A^{-1} b."""
    whole, g = right_out.shape[0] // n, 0
    while factor.groups[g] < whole:
        first, size = factor.groups[g], factor.groups[g + 1] - factor.groups[g]
        strips, _, inverses = _of_group(factor, n, first, size)
        padded = inverses.shape[1] * TILE
        x = factor.padded[: (n + COUPLED) * padded]
        x[:] = 0.0
        for f in range(n):
            for p in range(size):
                x[f * padded + p] = right_out[f * whole + first + p]
        substitute(strips, inverses, x)
        for f in range(n):
            for p in range(size):
                right_out[f * whole + first + p] = x[f * padded + p]
        g += 1


@compiled(types.boolean(BLOCKS, INDICES, MATRIX, MATRIX, SCALAR, FACTOR))
def factorize_bordered(
    blocks: Floats, groups: Integers, border: Floats, corner: Floats, damping: float, factor_out: BorderedFactor
) -> bool:
    """Factorize [[A, B], [B^T, C]] with its diagonal multiplied by 1 + damping.

    Args:
        blocks: A; block row f = blocks[f], its blocks beside one another, shape (n, m, 4 m): the last is on the
            diagonal, the first couples it with f - 3. What couples rows of different groups is not looked at.
        groups: Where each group of a block's rows begins, multiples of `TILE` from 0 on, and behind the last m.
        border: B by its columns, shape (k, n m).
        corner: C, shape (k, k).
        damping: Not negative.
        factor_out: The factors.

    Returns:
        Whether the system is positive definite; if not, the factors mean nothing.
    """
    n, whole, g = blocks.shape[0], blocks.shape[1], 0
    factor_out.groups[0] = 0
    while groups[g] < whole:
        first, size = groups[g], groups[g + 1] - groups[g]
        strips, spans, inverses = _of_group(factor_out, n, first, size)
        fill(blocks, first, size, damping, strips)
        if not factorize(size, strips, spans, inverses):
            return False
        g += 1
        factor_out.groups[g] = groups[g]
    more = border.shape[0]
    for e in range(more):
        factor_out.border[e] = border[e]
        factor_out.across[e] = border[e]
        _solve_band(factor_out, n, factor_out.across[e])
    pivots = factor_out.pivots
    pivot: float = corner[0, 0] * (1.0 + damping) - inner_product(border[0], factor_out.across[0])
    pivots[0] = pivot
    if more == 1 or not pivot > 0.0:
        return pivot > 0.0
    between: float = corner[0, 1] - inner_product(border[0], factor_out.across[1])
    second = corner[1, 1] * (1.0 + damping) - inner_product(border[1], factor_out.across[1]) - between / pivot * between
    pivots[1], pivots[2] = second, between / pivot
    return bool(second > 0.0)


@compiled(types.void(FACTOR, types.int64, VECTOR, types.Array(types.float64, 1, "C")))
def solve_factorized(factor: BorderedFactor, blocks: int, right: Floats, solution_out: Floats) -> None:
    """Solve a system of n blocks in factors for a right side; both have what is the border's last, shape (n m + k,)."""
    more, rows = factor.border.shape
    x = solution_out[:rows]
    x[:] = right[:rows]
    _solve_band(factor, blocks, x)
    first = right[rows] - inner_product(factor.border[0], x)
    if more > 1:
        second = right[rows + 1] - inner_product(factor.border[1], x) - factor.pivots[2] * first
        second /= factor.pivots[1]
        solution_out[rows + 1] = second
        first -= factor.pivots[2] * factor.pivots[0] * second
        for i in range(rows):
            x[i] -= second * factor.across[1, i]
    first /= factor.pivots[0]
    solution_out[rows] = first
    for i in range(rows):
        x[i] -= first * factor.across[0, i]
