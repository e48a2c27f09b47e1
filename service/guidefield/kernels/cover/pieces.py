"""Triangles halved until they are small, and gathered into elements by the cells of a grid; balls about these.

All sums keep their order, so that every number is what NumPy makes of the same triangles.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types, void

from guidefield.kernels.jit.signatures import (
    BLOCKS,
    BLOCKS_OUT,
    INDICES,
    INDICES_OUT,
    MATRIX,
    MATRIX_OUT,
    SCALAR,
    Floats,
    Integers,
    exact_kernel,
)

ROUNDING = 1.0 + 1e-12
"""By how much a ball is larger than the distance of its farthest point, whatever rounding does."""

LOOK_BACK = 32
"""A point is compared with the last so many that were kept."""


@exact_kernel(types.int64(BLOCKS, SCALAR, INDICES_OUT))
def longest_edges(corners: Floats, size: float, edges_out: Integers) -> int:
    """Find the longest edge of each triangle that has one longer than `size`.

    Args:
        corners: Of triangles, shape (n, 3, 3) [m].
        size: Of what is small enough [m].
        edges_out: Gets the first corner of that edge, the first such one of several; -1 of small triangles; shape (n,).

    Returns:
        How many aren't small.
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


@exact_kernel(void(BLOCKS, INDICES, INDICES, BLOCKS_OUT, INDICES_OUT, BLOCKS_OUT, INDICES_OUT))
def halve(
    corners: Floats,
    sources: Integers,
    edges: Integers,
    small_out: Floats,
    small_sources_out: Integers,
    halves_out: Floats,
    halves_sources_out: Integers,
) -> None:
    """Halve triangles at the middle of an edge.

    Args:
        corners: Shape (n, 3, 3) [m].
        sources: What they are part of, shape (n,).
        edges: First corner of the edge, -1 where nothing is to be halved; shape (n,).
        small_out: Gets the triangles that aren't halved, shape (n - k, 3, 3).
        small_sources_out: What they are part of, shape (n - k,).
        halves_out: Gets the halves of the others: all first ones, then all second ones; shape (2 k, 3, 3).
        halves_sources_out: What they are part of, shape (2 k,).
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


@exact_kernel(void(BLOCKS, SCALAR, INDICES_OUT))
def grid_cells(corners: Floats, size: float, cells_out: Integers) -> None:
    """Number the cells of a grid that the centroids of triangles lie in.

    Args:
        corners: Shape (n, 3, 3), n >= 1 [m].
        size: Width of the grid, which begins at the least coordinates of all centroids [m].
        cells_out: Gets the number of each triangle's cell, those along z one after the other; shape (n,).
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


@exact_kernel(types.int64(BLOCKS, INDICES, INDICES, INDICES_OUT, MATRIX_OUT))
def cell_middles(corners: Floats, cells: Integers, order: Integers, first_out: Integers, middles_out: Floats) -> int:
    """Find the middles of the boxes about all triangles of each cell.

    Args:
        corners: Shape (n, 3, 3) [m].
        cells: Of each triangle, shape (n,).
        order: Triangles by cell, shape (n,).
        first_out: Gets where in that order those of each cell begin, and n; shape (n + 1,).
        middles_out: Gets the middles, shape (n, 3) [m].

    Returns:
        How many cells there are.
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


@exact_kernel(void(BLOCKS, INDICES, INDICES, INDICES, INDICES, BLOCKS_OUT, INDICES_OUT, INDICES_OUT))
def gather(
    corners: Floats,
    sources: Integers,
    order: Integers,
    first: Integers,
    turn: Integers,
    corners_out: Floats,
    sources_out: Integers,
    first_out: Integers,
) -> None:
    """Put the triangles of each cell together.

    Args:
        corners: Shape (n, 3, 3) [m].
        sources: What they are part of, shape (n,).
        order: Triangles by cell, shape (n,).
        first: Where in that order those of each cell begin, and n; shape (m + 1,) at least.
        turn: Which cells come first, shape (m,).
        corners_out: Gets the triangles in that turn, shape (n, 3, 3).
        sources_out: What they are part of, shape (n,).
        first_out: Gets where those of each cell begin, and n; shape (m + 1,).
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


@exact_kernel(types.int64(MATRIX, INDICES, MATRIX_OUT, INDICES_OUT))
def distinct_points(corners: Floats, first: Integers, points_out: Floats, first_out: Integers) -> int:
    """Keep one of equal points of each run; of very many some equal ones may stay.

    Args:
        corners: Shape (k, 3) [m].
        first: Where each run begins, and k; shape (m + 1,).
        points_out: Gets the points, the first of equal ones, in their order, shape (k, 3).
        first_out: Gets where those of each run begin, and how many there are; shape (m + 1,).

    Returns:
        How many points there are.
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


@exact_kernel(void(MATRIX, INDICES, MATRIX_OUT))
def balls_about(points: Floats, first: Integers, balls_out: Floats) -> None:
    """Find a ball about each run of points: about the middle of their box.

    Args:
        points: Shape (k, 3) [m].
        first: Where each run begins, and k; shape (m + 1,).
        balls_out: Gets centres and radii, shape (m, 4) [m].
    """
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
