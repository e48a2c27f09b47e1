"""Solution of a symmetric, positive definite, banded system with one or two more rows, by a banded Cholesky factor.

With A = U^T U the border (B, C) adds the Schur complement C - B^T A^{-1} B. Rows of A's blocks fall into groups one
after the other; those of different groups aren't coupled in any block, and each group has a factor of its own. In it
rows of the identity fill each block up to whole tiles.
`optimize/newton_descent.py` solves its steps by it: `COUPLED` is that of cubic splines, of four control points.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from guidefield.kernels.jit.arrays import Blocks, Floats, Indices, IndicesOut, Integers, Row, RowOut, Rows, RowsOut
from guidefield.kernels.jit.decorators import counted, kernel, uncounted
from guidefield.kernels.simd.vector import LANES_64, load, magnitude, store, total

COUPLED = 3  # a block is coupled with as many before it
TILE = LANES_64  # rows and columns of a tile: eight, each of which the products below name
FIRST, PAST = 0, 1  # columns of spans: the first row of a strip that isn't zero, and the one past the last


@uncounted
def fill(blocks: Floats, first: int, size: int, damping: float, strips_out: Floats) -> None:
    """Write a group's upper triangle, with whole blocks on its diagonal, which is multiplied by 1 + damping.

    `blocks` (n, m, 4 m) are as in `factorize_bordered`, the group has `size` rows from `first` on; the strips are
    (n, strips, rows `TILE`). The damping is not negative.
    """
    n, whole = blocks.shape[0], blocks.shape[1]
    per_block = strips_out.shape[1] // (COUPLED + 1)
    for f in range(n):
        for j in range(COUPLED + 1):
            for t in range(per_block):
                strip, columns = strips_out[f, j * per_block + t], max(min(TILE, size - TILE * t), 0)
                strip[:] = 0.0
                if f + j < n:
                    begin = first + TILE * t
                    source = blocks[f + j, begin : begin + columns, (COUPLED - j) * whole + first :]
                    for p in range(size):
                        for c in range(columns):
                            strip[p * TILE + c] = source[c, p]
        for p in range(per_block * TILE):
            diagonal = strips_out[f, p // TILE][p * TILE + p % TILE :]
            diagonal[0] = diagonal[0] * (1.0 + damping) if p < size else 1.0


@uncounted
def _store_tile(  # type: ignore[no-untyped-def]  # vectors have no type in Python
    c: Floats, r0, r1, r2, r3, r4, r5, r6, r7
) -> None:
    store(c, 0, r0)
    store(c, TILE, r1)
    store(c, 2 * TILE, r2)
    store(c, 3 * TILE, r3)
    store(c, 4 * TILE, r4)
    store(c, 5 * TILE, r5)
    store(c, 6 * TILE, r6)
    store(c, 7 * TILE, r7)


@uncounted
def _take_product(a: Floats, b: Floats, rows: int, c: Floats) -> None:
    """Subtract a^T b from a tile c, of two strips of a given number of rows."""
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
    _store_tile(c, c0, c1, c2, c3, c4, c5, c6, c7)


@uncounted
def _take_products(a: Floats, b: Floats, b_: Floats, rows: int, c: Floats, c_: Floats) -> None:
    """Subtract a^T b from a tile c and a^T b_ from c_ at once: each number of a is read once."""
    c0, c1, c2, c3 = load(c, 0), load(c, TILE), load(c, 2 * TILE), load(c, 3 * TILE)
    c4, c5, c6, c7 = load(c, 4 * TILE), load(c, 5 * TILE), load(c, 6 * TILE), load(c, 7 * TILE)
    d0, d1, d2, d3 = load(c_, 0), load(c_, TILE), load(c_, 2 * TILE), load(c_, 3 * TILE)
    d4, d5, d6, d7 = load(c_, 4 * TILE), load(c_, 5 * TILE), load(c_, 6 * TILE), load(c_, 7 * TILE)
    for k in range(rows):
        at = k * TILE
        row, other = load(b, at), load(b_, at)
        a0, a1, a2, a3, a4, a5, a6, a7 = (
            a[at], a[at + 1], a[at + 2], a[at + 3], a[at + 4], a[at + 5], a[at + 6], a[at + 7],
        )  # fmt: skip
        c0 -= a0 * row
        d0 -= a0 * other
        c1 -= a1 * row
        d1 -= a1 * other
        c2 -= a2 * row
        d2 -= a2 * other
        c3 -= a3 * row
        d3 -= a3 * other
        c4 -= a4 * row
        d4 -= a4 * other
        c5 -= a5 * row
        d5 -= a5 * other
        c6 -= a6 * row
        d6 -= a6 * other
        c7 -= a7 * row
        d7 -= a7 * other
    _store_tile(c, c0, c1, c2, c3, c4, c5, c6, c7)
    _store_tile(c_, d0, d1, d2, d3, d4, d5, d6, d7)


@uncounted
def _take_strip(a: Floats, of_a: Integers, b: Floats, of_b: Integers, most: int, c: Floats) -> None:
    """`_take_product` of the rows before `most` in which neither strip is zero; their spans are given."""
    first, past = max(of_a[FIRST], of_b[FIRST]), min(of_a[PAST], of_b[PAST], most)
    if first < past:
        _take_product(a[first * TILE :], b[first * TILE :], past - first, c)


@uncounted
def _take_strips(
    a: Floats, of_a: Integers, b: Floats, of_b: Integers, s: int, most: int, into: Floats, into_s: int, at: int
) -> None:
    """`_take_products` of such rows: of strips s and s + 1 of b, into strips `into_s` and the next from `at`."""
    first = max(of_a[FIRST], min(of_b[s, FIRST], of_b[s + 1, FIRST]))
    past = min(of_a[PAST], max(of_b[s, PAST], of_b[s + 1, PAST]), most)
    if first < past:
        begin = first * TILE
        _take_products(
            a[begin:], b[s, begin:], b[s + 1, begin:], past - first, into[into_s, at:], into[into_s + 1, at:]
        )


@uncounted
def _factorize_tile(tile: Floats, inverse_out: Floats) -> bool:
    """Get U^-T of a tile on the diagonal, U^T U; whether it is positive definite. The tile is overwritten."""
    nothing = 0.0 * load(tile, 0)
    for i in range(TILE):
        row, of_inverse = load(tile, i * TILE), nothing
        for k in range(i):
            share = tile[k * TILE + i]
            row -= share * load(tile, k * TILE)
            of_inverse -= share * load(inverse_out, k * TILE)
        store(tile, i * TILE, row)
        pivot = tile[i * TILE + i]
        if not pivot > 0.0:
            return False
        scale = 1.0 / math.sqrt(pivot)
        store(tile, i * TILE, scale * row)
        store(inverse_out, i * TILE, scale * of_inverse)
        inverse_out[i * TILE + i] = scale
    return True


@uncounted
def _solve_tile(inverse: Floats, c: Floats) -> bool:
    """Replace a tile c by U^-T c, with U^-T of a tile on the diagonal; whether anything in it isn't zero."""
    r0, r1, r2, r3 = load(c, 0), load(c, TILE), load(c, 2 * TILE), load(c, 3 * TILE)
    r4, r5, r6, r7 = load(c, 4 * TILE), load(c, 5 * TILE), load(c, 6 * TILE), load(c, 7 * TILE)
    amount = magnitude(r0) + magnitude(r1) + magnitude(r2) + magnitude(r3)
    amount += magnitude(r4) + magnitude(r5) + magnitude(r6) + magnitude(r7)
    if total(amount) == 0.0:
        return False
    for i in range(TILE):
        w = inverse[i * TILE :]
        first = w[0] * r0 + w[1] * r1 + w[2] * r2 + w[3] * r3
        store(c, i * TILE, first + (w[4] * r4 + w[5] * r5 + w[6] * r6 + w[7] * r7))
    return True


@uncounted
def _take_blocks_before(f: int, strips: Floats, spans: Integers) -> None:
    """Subtract from block row f what those before it take away: two strips stay in the fastest memory for that."""
    count = strips.shape[1]
    per_block = count // (COUPLED + 1)
    into = strips[f]
    for s in range(0, count, 2):
        for g in range(max(f - COUPLED, 0), f):
            behind = (f - g) * per_block
            column, of_g, spans_of_g = behind + s, strips[g], spans[g]
            if column >= count:
                continue
            both = min(s + 1, per_block) if column + 1 < count else 0
            for t in range(both):
                _take_strips(
                    of_g[behind + t], spans_of_g[behind + t], of_g, spans_of_g, column, TILE * per_block, into, s,
                    t * TILE * TILE,
                )  # fmt: skip
            for b in range(2):
                for t in range(both, min(s + b + 1, per_block)):
                    if column + b < count:
                        _take_strip(
                            of_g[behind + t], spans_of_g[behind + t], of_g[column + b], spans_of_g[column + b],
                            TILE * per_block, into[s + b, t * TILE * TILE :],
                        )  # fmt: skip


@uncounted
def factorize(size: int, strips: Floats, spans: Integers, inverses: Floats) -> bool:
    """Replace a matrix A by its factor U, A = U^T U, if it is positive definite; else the strips mean nothing.

    `size` is the number of rows of its blocks, without those of the identity; strips (n, strips, rows `TILE`) are as
    `fill` leaves them. Spans (n, strips, 2) get where each strip isn't zero, inverses (n, tiles, `TILE`²) U^-T of each
    tile on the diagonal, which itself means nothing.
    """
    n, count, _ = strips.shape
    per_block = count // (COUPLED + 1)
    for f in range(n):
        _take_blocks_before(f, strips, spans)
        of_f, spans_of_f = strips[f], spans[f]
        spans_of_f[:, FIRST], spans_of_f[:, PAST] = size, 0
        for t in range(per_block):
            at, inverse = t * TILE * TILE, inverses[f, t]
            _take_strip(of_f[t], spans_of_f[t], of_f[t], spans_of_f[t], t * TILE, of_f[t, at:])
            if not _factorize_tile(of_f[t, at:], inverse):
                return False
            for s in range(t + 1 + (count - t - 1) % 2, count, 2):
                _take_strips(of_f[t], spans_of_f[t], of_f, spans_of_f, s, t * TILE, of_f, s, at)
            if (count - t - 1) % 2:
                _take_strip(of_f[t], spans_of_f[t], of_f[t + 1], spans_of_f[t + 1], t * TILE, of_f[t + 1, at:])
            for s in range(t + 1, count):
                if _solve_tile(inverse, of_f[s, at:]):
                    spans_of_f[s, FIRST] = min(spans_of_f[s, FIRST], t * TILE)
                    spans_of_f[s, PAST] = min((t + 1) * TILE, size)
    return True


@uncounted
def _substitute_tile(inverse: Floats, x: Floats) -> None:
    """Replace x by U^-T x, with U^-T of a tile on the diagonal."""
    y = load(x, 0)
    for i in range(TILE):
        x[i] = total(load(inverse, i * TILE) * y)


@uncounted
def _substitute_tile_back(inverse: Floats, x: Floats) -> None:
    """Replace x by U^-1 x, with U^-T of a tile on the diagonal."""
    first = x[0] * load(inverse, 0) + x[1] * load(inverse, TILE)
    first += x[2] * load(inverse, 2 * TILE) + x[3] * load(inverse, 3 * TILE)
    second = x[4] * load(inverse, 4 * TILE) + x[5] * load(inverse, 5 * TILE)
    second += x[6] * load(inverse, 6 * TILE) + x[7] * load(inverse, 7 * TILE)
    store(x, 0, first + second)


@uncounted
def substitute(strips: Floats, inverses: Floats, right: Floats) -> None:
    """Replace b by (U^T U)^{-1} b, with strips (n, strips, rows `TILE`) and inverses of `factorize`.

    b has blocks filled up to whole tiles, as the factor, and three more, of zeros, behind them: ((n + 3) rows,).
    """
    n, count, _ = strips.shape
    per_block = count // (COUPLED + 1)
    for f in range(n):
        for t in range(per_block):
            x = right[(f * per_block + t) * TILE :]
            _substitute_tile(inverses[f, t], x)
            for s in range(t + 1, count):
                tile, at = strips[f, s][t * TILE * TILE :], (s - t) * TILE
                row = x[0] * load(tile, 0) + x[1] * load(tile, TILE)
                row += x[2] * load(tile, 2 * TILE) + x[3] * load(tile, 3 * TILE)
                other = x[4] * load(tile, 4 * TILE) + x[5] * load(tile, 5 * TILE)
                other += x[6] * load(tile, 6 * TILE) + x[7] * load(tile, 7 * TILE)
                store(x, at, load(x, at) - row - other)
    for f in range(n - 1, -1, -1):
        for t in range(per_block - 1, -1, -1):
            x = right[(f * per_block + t) * TILE :]
            _take_later(strips[f], t, x)
            _substitute_tile_back(inverses[f, t], x)


@uncounted
def _take_later(strips: Floats, t: int, x: Floats) -> None:
    """Subtract from x, tile t of a block's, what a row of tiles times all that is behind it comes to."""
    a0 = 0.0 * load(x, 0)
    a1 = a2 = a3 = a4 = a5 = a6 = a7 = a0
    for s in range(t + 1, strips.shape[0]):
        tile, y = strips[s][t * TILE * TILE :], load(x, (s - t) * TILE)
        a0 += load(tile, 0) * y
        a1 += load(tile, TILE) * y
        a2 += load(tile, 2 * TILE) * y
        a3 += load(tile, 3 * TILE) * y
        a4 += load(tile, 4 * TILE) * y
        a5 += load(tile, 5 * TILE) * y
        a6 += load(tile, 6 * TILE) * y
        a7 += load(tile, 7 * TILE) * y
    x[0] -= total(a0)
    x[1] -= total(a1)
    x[2] -= total(a2)
    x[3] -= total(a3)
    x[4] -= total(a4)
    x[5] -= total(a5)
    x[6] -= total(a6)
    x[7] -= total(a7)


class BorderedFactor(NamedTuple):
    """A system [[A, B], [B^T, C]] in factors, with k = 1 or 2 columns in B; of memory until it is made."""

    # where each group of a block's rows begins, and where the last ends; behind that it means nothing
    groups: IndicesOut
    strips: RowOut  # U of A = U^T U, group by group as `factorize` leaves it
    spans: IndicesOut  # where its strips aren't zero
    inverses: RowOut  # of its tiles on the diagonal, transposed
    padded: RowOut  # memory for a group's right side, as `substitute` takes it
    border: RowsOut  # B by its columns, shape (k, n m)
    across: RowsOut  # A^-1 B by its columns, shape (k, n m)
    # of S = C - B^T A^-1 B: the first, the one that the first leaves of the second, and the share of the first row that
    # is in the second; shape (3,)
    pivots: RowOut


def allocate_factor(n: int, size: int, more: int) -> BorderedFactor:
    """Allocate a factor for n blocks of a size, and one or two more rows."""
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


@kernel
def factorize_bordered(
    blocks: Blocks, groups: Indices, border: Rows, corner: Rows, damping: float, factor_out: BorderedFactor
) -> bool:
    """Factorize [[A, B], [B^T, C]] with its diagonal times 1 + damping; tell if it is positive definite.

    `blocks` (n, m, 4 m) are A, block row by block row, side by side: the last is on the diagonal, the first couples it
    with f - 3; what couples rows of different groups is not read. `groups` has where each group of a block's rows
    begins, multiples of `TILE` from 0 on, and behind the last m. `border` (k, n m) is B by its columns, `corner` (k, k)
    is C. If it isn't positive definite, the factors mean nothing.
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


@kernel
def solve_factorized(factor: BorderedFactor, blocks: int, right: Row, solution_out: RowOut) -> None:
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
