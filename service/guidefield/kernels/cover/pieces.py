"""Triangles halved until they are small, gathered into elements by the cells of a grid, balls about these, and orders.

All sums keep their order, but in `farthest_first`, which may decide ties otherwise: so every number is what NumPy makes
of the same triangles, on every machine. Covers (`geometry/cover.py`) are made of elements, charges
(`robot/link_charges.py`) of what `farthest_first` chooses: another order changes them.
"""

from __future__ import annotations

import math

import numpy as np

from guidefield.kernels.jit.arrays import Blocks, BlocksOut, Floats, Indices, IndicesOut, Rows, RowsOut
from guidefield.kernels.jit.decorators import exact_kernel, inlined, kernel

BLOCK = 64  # candidates that share a ball, which `farthest_first` leaves out together; for speed only


@inlined
def _balls(candidates: Floats, balls: Floats) -> None:
    """Centre and radius of a ball around every block, about the middle of its extents."""
    for b in range(balls.shape[0]):
        first, past = b * BLOCK, min((b + 1) * BLOCK, candidates.shape[0])
        for c in range(3):
            low, high = candidates[first, c], candidates[first, c]
            for i in range(first, past):
                low, high = min(low, candidates[i, c]), max(high, candidates[i, c])
            balls[b, c] = 0.5 * (low + high)
        square = 0.0
        for i in range(first, past):
            dx, dy, dz = candidates[i, 0] - balls[b, 0], candidates[i, 1] - balls[b, 1], candidates[i, 2] - balls[b, 2]
            square = max(square, dx * dx + dy * dy + dz * dz)
        balls[b, 3] = math.sqrt(square)


@kernel
def farthest_first(candidates: Rows, start: int, spacing: float, chosen_out: IndicesOut, owner_out: IndicesOut) -> int:
    """Choose candidates until none is as far as `spacing` from those chosen [m]; return their count.

    `candidates` (n, 3) stand so that neighbours are near each other, ties go to the first, `start` is chosen first.
    Writes the chosen in order, and of each candidate the place in that order of the nearest chosen one, shapes (n,).
    """
    n = candidates.shape[0]
    blocks = (n + BLOCK - 1) // BLOCK
    balls, farthest, which = np.empty((blocks, 4)), np.full(blocks, np.inf), np.zeros(blocks, np.int64)
    _balls(candidates, balls)
    nearest = np.full(n, np.inf)
    count, new = 0, start
    while True:
        chosen_out[count] = new
        x, y, z = candidates[new, 0], candidates[new, 1], candidates[new, 2]
        best, block = -1.0, 0
        for b in range(blocks):
            dx, dy, dz = balls[b, 0] - x, balls[b, 1] - y, balls[b, 2] - z
            # beyond the farthest member's distance nothing in the block comes nearer
            reach = balls[b, 3] + math.sqrt(farthest[b])
            if dx * dx + dy * dy + dz * dz < reach * reach:
                farthest[b] = -1.0
                for i in range(b * BLOCK, min((b + 1) * BLOCK, n)):
                    ex, ey, ez = candidates[i, 0] - x, candidates[i, 1] - y, candidates[i, 2] - z
                    square = ex * ex + ey * ey + ez * ez
                    if square < nearest[i]:
                        nearest[i] = square
                        owner_out[i] = count
                    if nearest[i] > farthest[b]:
                        farthest[b], which[b] = nearest[i], i
            if farthest[b] > best:
                best, block = farthest[b], b
        count += 1
        if best < spacing * spacing or count == n:
            return count
        new = which[block]


BITS = 11  # of a digit of the radix sort: its table of 2,048 starts stays in the cache; for speed only


@kernel
def stable_order(numbers: Indices, order_out: IndicesOut) -> None:
    """Write the order (n,) of whole numbers (n,), none negative; equal ones keep that of their places (radix sort)."""
    largest = 0
    for i in range(numbers.shape[0]):
        order_out[i] = i
        largest = max(largest, numbers[i])
    before, starts = np.empty(numbers.shape[0], np.int64), np.empty((1 << BITS) + 1, np.int64)
    shift = 0
    while largest >> shift > 0:
        before[:] = order_out
        starts[:] = 0
        for i in range(numbers.shape[0]):
            starts[(numbers[i] >> shift & ((1 << BITS) - 1)) + 1] += 1
        for digit in range(1 << BITS):
            starts[digit + 1] += starts[digit]
        for i in range(numbers.shape[0]):
            digit = numbers[before[i]] >> shift & ((1 << BITS) - 1)
            order_out[starts[digit]] = before[i]
            starts[digit] += 1
        shift += BITS
        if shift > 62:  # all digits of a number of 63 bits
            return


ROUNDING = 1.0 + 1e-12  # a ball's radius over the distance of its farthest point, for rounding: it may grow, not shrink
LOOK_BACK = 32  # a point is compared with the last this many that were kept; for speed only


@exact_kernel
def longest_edges(corners: Blocks, size: float, edges_out: IndicesOut) -> int:
    """Write the longest edge longer than `size` of each of triangles (n, 3, 3) [m]; return how many have one.

    An edge is given by its first corner, the first of several; -1 of small triangles; shape (n,).
    """
    count = 0
    for i in range(corners.shape[0]):
        longest, edge = size, -1
        for k in range(3):
            n = (k + 1) % 3
            dx = corners[i, n, 0] - corners[i, k, 0]
            dy = corners[i, n, 1] - corners[i, k, 1]
            dz = corners[i, n, 2] - corners[i, k, 2]
            length = math.sqrt(dx * dx + dy * dy + dz * dz)
            if length > longest:
                longest, edge = length, k
        edges_out[i] = edge
        count += 1 if edge >= 0 else 0
    return count


@exact_kernel
def halve(
    corners: Blocks,
    sources: Indices,
    edges: Indices,
    small_out: BlocksOut,
    small_sources_out: IndicesOut,
    halves_out: BlocksOut,
    halves_sources_out: IndicesOut,
) -> None:
    """Halve triangles (n, 3, 3) [m] at the middle of `edges` (n,), -1 where nothing is to be halved.

    Writes the k others, then all first and all second halves (2 k, 3, 3), each with the `sources` (n,) that they are
    part of.
    """
    many = halves_out.shape[0] // 2
    small = half = 0
    for i in range(corners.shape[0]):
        if edges[i] < 0:
            for n in range(3):
                for k in range(3):
                    small_out[small, n, k] = corners[i, n, k]
            small_sources_out[small] = sources[i]
            small += 1
            continue
        a, b, c = edges[i], (edges[i] + 1) % 3, (edges[i] + 2) % 3
        for k in range(3):
            middle = 0.5 * (corners[i, a, k] + corners[i, b, k])
            halves_out[half, 0, k] = corners[i, a, k]
            halves_out[half, 1, k] = middle
            halves_out[half, 2, k] = corners[i, c, k]
            halves_out[many + half, 0, k] = middle
            halves_out[many + half, 1, k] = corners[i, b, k]
            halves_out[many + half, 2, k] = corners[i, c, k]
        halves_sources_out[half] = halves_sources_out[many + half] = sources[i]
        half += 1


@exact_kernel
def grid_cells(corners: Blocks, size: float, cells_out: IndicesOut) -> None:
    """Number the cells of a grid of width `size` [m] that the centroids of triangles (n, 3, 3), n >= 1, lie in; (n,).

    The grid begins at the least coordinates of all centroids; cells along z follow one another.
    """
    count = corners.shape[0]
    centroids, least, most = np.empty((count, 3)), np.full(3, np.inf), np.full(3, -np.inf)
    for i in range(count):
        for k in range(3):
            centre = (corners[i, 0, k] + corners[i, 1, k] + corners[i, 2, k]) / 3.0
            centroids[i, k] = centre
            least[k], most[k] = min(least[k], centre), max(most[k], centre)
    rows = np.int64(math.floor((most[1] - least[1]) / size)) + 1
    columns = np.int64(math.floor((most[2] - least[2]) / size)) + 1
    for i in range(count):
        x = np.int64(math.floor((centroids[i, 0] - least[0]) / size))
        y = np.int64(math.floor((centroids[i, 1] - least[1]) / size))
        z = np.int64(math.floor((centroids[i, 2] - least[2]) / size))
        cells_out[i] = (x * rows + y) * columns + z


@exact_kernel
def cell_middles(corners: Blocks, cells: Indices, order: Indices, first_out: IndicesOut, middles_out: RowsOut) -> int:
    """Write the middles (n, 3) of the boxes about all triangles of each cell [m]; return how many cells there are.

    Of triangles (n, 3, 3), their `cells` (n,), and `order` (n,) by cell; `first_out` (n + 1,) gets where in that order
    each cell begins, and n.
    """
    low, high = np.empty(3), np.empty(3)
    count, begin = 0, 0
    while begin < order.shape[0]:
        low[:], high[:] = np.inf, -np.inf
        end = begin
        while end < order.shape[0] and cells[order[end]] == cells[order[begin]]:
            for j in range(3):
                for k in range(3):
                    low[k], high[k] = min(low[k], corners[order[end], j, k]), max(high[k], corners[order[end], j, k])
            end += 1
        first_out[count] = begin
        for k in range(3):
            middles_out[count, k] = 0.5 * (low[k] + high[k])
        count += 1
        begin = end
    first_out[count] = begin
    return count


@exact_kernel
def gather(
    corners: Blocks,
    sources: Indices,
    order: Indices,
    first: Indices,
    turn: Indices,
    corners_out: BlocksOut,
    sources_out: IndicesOut,
    first_out: IndicesOut,
) -> None:
    """Put the triangles (n, 3, 3) of each cell together, with their `sources` (n,), the cells in a `turn` (m,).

    `order` (n,) and `first` (m + 1,) are as `cell_middles` has them; `first_out` (m + 1,) gets where each cell begins
    now, and n.
    """
    at = 0
    for m in range(turn.shape[0]):
        first_out[m] = at
        for k in range(first[turn[m]], first[turn[m] + 1]):
            for n in range(3):
                for j in range(3):
                    corners_out[at, n, j] = corners[order[k], n, j]
            sources_out[at] = sources[order[k]]
            at += 1
    first_out[turn.shape[0]] = at


@exact_kernel
def distinct_points(corners: Rows, first: Indices, points_out: RowsOut, first_out: IndicesOut) -> int:
    """Keep one of equal points of each run of `corners` (k, 3) [m]; of very many some may stay. Return their count.

    Runs begin at `first` (m + 1,), those of `points_out` (k, 3) at `first_out`.
    """
    count = 0
    for m in range(first.shape[0] - 1):
        first_out[m] = count
        for i in range(first[m], first[m + 1]):
            x, y, z = corners[i, 0], corners[i, 1], corners[i, 2]
            is_new = True
            for k in range(count - 1, max(first_out[m], count - LOOK_BACK) - 1, -1):
                if points_out[k, 0] == x and points_out[k, 1] == y and points_out[k, 2] == z:
                    is_new = False
                    break
            if is_new:
                points_out[count, 0], points_out[count, 1], points_out[count, 2] = x, y, z
                count += 1
    first_out[first.shape[0] - 1] = count
    return count


@exact_kernel
def balls_about(points: Rows, first: Indices, balls_out: RowsOut) -> None:
    """Write balls (m, 4) about runs of `points` (k, 3), which begin at `first`: about the middles of boxes [m]."""
    for m in range(balls_out.shape[0]):
        for k in range(3):
            low, high = math.inf, -math.inf
            for i in range(first[m], first[m + 1]):
                low, high = min(low, points[i, k]), max(high, points[i, k])
            balls_out[m, k] = 0.5 * (low + high)
        square = 0.0
        for i in range(first[m], first[m + 1]):
            dx, dy, dz = points[i, 0] - balls_out[m, 0], points[i, 1] - balls_out[m, 1], points[i, 2] - balls_out[m, 2]
            square = max(square, dx * dx + dy * dy + dz * dz)
        balls_out[m, 3] = math.sqrt(square) * ROUNDING
