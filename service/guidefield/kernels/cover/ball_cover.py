"""Set cover by balls: which balls contain which elements, a greedy choice, and the least radii that still contain all.

An element is a small body, such as some triangles, that is in a ball if its corners are; 64 stand in a word of bits, as
in `geometry/cover.py`, whose proofs rest on `contained` and `reaches`; another greedy choice makes another cover. Also
spread and extents of clusters of triangles, for `batch/surface_tables.py`. Rows (n, 4) are centre and radius [m].
"""

from __future__ import annotations

import math

import numpy as np
from numba import uint64

from guidefield.kernels.jit.arrays import (
    Blocks,
    BlocksOut,
    Floats,
    IndexRows,
    Indices,
    IndicesOut,
    RowOut,
    Rows,
    RowsOut,
    WordRows,
    WordRowsOut,
    Words,
)
from guidefield.kernels.jit.decorators import inlined, kernel, optimized


@inlined
def ones(word: int) -> int:
    """Number of bits of a word that are set."""
    word = word - ((word >> uint64(1)) & uint64(0x5555555555555555))
    word = (word & uint64(0x3333333333333333)) + ((word >> uint64(2)) & uint64(0x3333333333333333))
    word = (word + (word >> uint64(4))) & uint64(0x0F0F0F0F0F0F0F0F)
    total: int = (word * uint64(0x0101010101010101)) >> uint64(56)
    return np.int64(total)  # type: ignore[return-value]


@inlined
def lowest(word: int) -> int:
    """Place of the lowest bit that is set."""
    return ones((word & (~word + uint64(1))) - uint64(1))


@kernel
def greedy_choice(bits: WordRows, chosen_out: IndicesOut) -> int:
    """Choose sets that together contain every element that any contains, the most fruitful first; return their count.

    `bits` (n, words) says which set contains which element; `chosen_out` (n,) gets the chosen in order. A set's worth
    only falls while others are chosen, so that it is counted again only when it would be next.
    """
    rows, words = bits.shape
    missing = np.full(words, ~uint64(0), np.uint64)
    worth = np.empty(rows, np.int64)
    for i in range(rows):
        total = 0
        for w in range(words):
            total += ones(bits[i, w])
        worth[i] = total
    count = 0
    while rows > 0:
        best = 0
        for i in range(rows):
            if worth[i] > worth[best]:
                best = i
        if worth[best] == 0:
            return count
        total = 0
        for w in range(words):
            total += ones(bits[best, w] & missing[w])
        if total < worth[best]:
            worth[best] = total
            continue
        for w in range(words):
            missing[w] &= ~bits[best, w]
        worth[best] = 0
        chosen_out[count] = best
        count += 1
    return count


@inlined
def _reach_squared(x: float, y: float, z: float, corners: Floats, first: int, last: int) -> float:
    """Square of the largest distance from a point to rows `first` to `last` - 1 of `corners`."""
    farthest = 0.0
    for k in range(first, last):
        dx, dy, dz = corners[k, 0] - x, corners[k, 1] - y, corners[k, 2] - z
        farthest = max(farthest, dx * dx + dy * dy + dz * dz)
    return farthest


@inlined
def _contains(balls: Floats, i: int, corners: Floats, first: np.ndarray, bounds: Floats, j: int) -> bool:
    x, y, z, radius = balls[i, 0], balls[i, 1], balls[i, 2], balls[i, 3]
    dx, dy, dz = bounds[j, 0] - x, bounds[j, 1] - y, bounds[j, 2] - z
    gap = dx * dx + dy * dy + dz * dz
    beyond, within = radius + bounds[j, 3], radius - bounds[j, 3]
    if gap > beyond * beyond:
        return False
    if within > 0.0 and gap <= within * within:
        return True
    inside: bool = _reach_squared(x, y, z, corners, first[j], first[j + 1]) <= radius * radius
    return inside


@inlined
def _is_within(x: float, y: float, z: float, square: float, corners: Floats, first: int, last: int) -> bool:
    """Tell if none of rows `first` to `last` - 1 of `corners` is further from a point than the root of `square`."""
    for k in range(first, last):
        dx, dy, dz = corners[k, 0] - x, corners[k, 1] - y, corners[k, 2] - z
        if dx * dx + dy * dy + dz * dz > square:
            return False
    return True


@optimized
def _by_bounds(balls: Floats, i: int, bounds: Floats, w: int, words_out: np.ndarray) -> None:
    """Say which of the 64 elements of word w are in ball i, and which may be: what the balls about them say."""
    x, y, z, radius = balls[i, 0], balls[i, 1], balls[i, 2], balls[i, 3]
    inside, near = uint64(0), uint64(0)
    for j in range(64):
        dx, dy, dz = bounds[w, 0, j] - x, bounds[w, 1, j] - y, bounds[w, 2, j] - z
        gap = dx * dx + dy * dy + dz * dz
        beyond, within = radius + bounds[w, 3, j], radius - bounds[w, 3, j]
        inside |= uint64((within > 0.0) & (gap <= within * within)) << uint64(j)
        near |= uint64(gap <= beyond * beyond) << uint64(j)
    words_out[0], words_out[1] = inside, near & ~inside


@inlined
def _in_words(bounds: Floats, words: int) -> Floats:
    """Balls as x, y, z and radius of 64 each, shape (words, 4, 64) [m]; those that there aren't are infinitely far."""
    packed = np.zeros((words, 4, 64))
    packed[:, 0] = np.inf
    for j in range(bounds.shape[0]):
        for k in range(4):
            packed[j >> 6, k, j & 63] = bounds[j, k]
    return packed


@kernel
def contained(balls: Rows, corners: Rows, first: Indices, bounds: Rows, blocks: Rows, bits_out: WordRowsOut) -> None:
    """Write which elements are in which of `balls` (n, 4) as bits (n, words), all zero before: bit j of row i.

    Corners (k, 3) stand element by element, from `first` (m + 1,) on; `bounds` (m, 4) are balls about elements and
    `blocks` (words, 4) about every 64 of them, which decide most [m].
    """
    elements, found, packed = bounds.shape[0], np.empty(2, np.uint64), _in_words(bounds, blocks.shape[0])
    for i in range(balls.shape[0]):
        x, y, z, radius = balls[i, 0], balls[i, 1], balls[i, 2], balls[i, 3]
        for w in range(blocks.shape[0]):
            dx, dy, dz = blocks[w, 0] - x, blocks[w, 1] - y, blocks[w, 2] - z
            gap = dx * dx + dy * dy + dz * dz
            beyond, within = radius + blocks[w, 3], radius - blocks[w, 3]
            if gap > beyond * beyond:
                continue
            if within > 0.0 and gap <= within * within:
                bits_out[i, w] = ~uint64(0) >> uint64(max(64 * (w + 1) - elements, 0))
                continue
            _by_bounds(balls, i, packed, w, found)
            word, near = found[0], found[1]
            while near != uint64(0):
                j = lowest(near)
                near &= near - uint64(1)
                k = 64 * w + j
                if radius > 0.0 and _is_within(x, y, z, radius * radius, corners, first[k], first[k + 1]):
                    word |= uint64(1) << uint64(j)
            bits_out[i, w] = word


@inlined
def _near(balls: Floats, blocks: Floats, w: int, near_out: np.ndarray) -> int:
    """Indices of the balls that touch block w, and how many they are."""
    count = 0
    for i in range(balls.shape[0]):
        dx, dy, dz = blocks[w, 0] - balls[i, 0], blocks[w, 1] - balls[i, 1], blocks[w, 2] - balls[i, 2]
        beyond = balls[i, 3] + blocks[w, 3]
        if dx * dx + dy * dy + dz * dz <= beyond * beyond:
            near_out[count] = i
            count += 1
    return count


@inlined
def _reach(balls: Floats, i: int, corners: Floats, first: np.ndarray, j: int) -> float:
    """Radius that ball i needs for element j, which it contains [m]."""
    square = _reach_squared(balls[i, 0], balls[i, 1], balls[i, 2], corners, first[j], first[j + 1])
    reach: float = min(math.sqrt(square), balls[i, 3])
    return reach


@kernel
def reaches(
    balls: Rows, corners: Rows, first: Indices, bounds: Rows, blocks: Rows, radii_out: RowOut, owners_out: IndicesOut
) -> None:
    """Share elements out among balls that together contain them, so that the balls can shrink.

    A ball first reaches for the elements that no other contains; the others go to a ball that reaches them anyway, else
    to the one that has to grow least. Arguments are those of `contained`. Writes how far each ball reaches (n,) [m], 0
    if for nothing, and the ball of each element (m,), -1 if none contains it.
    """
    radii_out[:] = 0.0
    owners_out[:] = -1
    near = np.empty(balls.shape[0], np.int64)
    shared = np.zeros(bounds.shape[0], np.bool_)
    for w in range(blocks.shape[0]):
        count = _near(balls, blocks, w, near)
        for j in range(64 * w, min(64 * (w + 1), bounds.shape[0])):
            times, last = 0, -1
            for k in range(count):
                if _contains(balls, near[k], corners, first, bounds, j):
                    times += 1
                    last = near[k]
            shared[j] = times > 1
            if times == 1:
                owners_out[j] = last
                radii_out[last] = max(radii_out[last], _reach(balls, last, corners, first, j))
    for w in range(blocks.shape[0]):
        count = _near(balls, blocks, w, near)
        for j in range(64 * w, min(64 * (w + 1), bounds.shape[0])):
            best, growth, farther = -1, math.inf, 0.0
            for k in range(count if shared[j] else 0):
                i = near[k]
                if growth > 0.0 and _contains(balls, i, corners, first, bounds, j):
                    reach = _reach(balls, i, corners, first, j)
                    if max(reach - radii_out[i], 0.0) < growth:
                        best, growth, farther = i, max(reach - radii_out[i], 0.0), reach
            if best >= 0:
                owners_out[j] = best
                radii_out[best] = max(radii_out[best], farther)


@kernel
def held_points(balls: Rows, points: Rows, bits_out: WordRowsOut) -> None:
    """Write which of `balls` (n, 4) holds which of `points` (m, 3) [m]: bit j of row i, shape (n, words)."""
    count = points.shape[0]
    x, y, z = points[:, 0].copy(), points[:, 1].copy(), points[:, 2].copy()
    for i in range(balls.shape[0]):
        square = balls[i, 3] * balls[i, 3]
        for w in range(bits_out.shape[1]):
            word = uint64(0)
            for j in range(64 * w, min(64 * (w + 1), count)):
                dx, dy, dz = x[j] - balls[i, 0], y[j] - balls[i, 1], z[j] - balls[i, 2]
                word |= uint64(dx * dx + dy * dy + dz * dz <= square) << uint64(j & 63)
            bits_out[i, w] = word


@kernel
def count_missing(bits: WordRows, missing: Words, counts_out: IndicesOut) -> None:
    """Count how many of the `missing` points (words,) each ball holds, by `bits` (n, words); shape (n,)."""
    for i in range(bits.shape[0]):
        count = 0
        for w in range(bits.shape[1]):
            count += ones(bits[i, w] & missing[w])
        counts_out[i] = count


@kernel
def cluster_spreads(corners: Blocks, members: IndexRows, centres_out: RowsOut, spreads_out: BlocksOut) -> None:
    """Write the means of clusters' corners (n, 3) [m], and sums of products of coordinates about them (n, 3, 3).

    `corners` (t, 3, 3) are those of all triangles, `members` (n, k) the triangles of each cluster.
    """
    each = members.shape[1]
    for cluster in range(members.shape[0]):
        for k in range(3):
            total = 0.0
            for i in range(each):
                for corner in range(3):
                    total += corners[members[cluster, i], corner, k]
            centres_out[cluster, k] = total / (3 * each)
        for row in range(3):
            for column in range(row + 1):
                total = 0.0
                for i in range(each):
                    for corner in range(3):
                        here = corners[members[cluster, i], corner, row] - centres_out[cluster, row]
                        total += here * (corners[members[cluster, i], corner, column] - centres_out[cluster, column])
                spreads_out[cluster, row, column] = spreads_out[cluster, column, row] = total


@kernel
def cluster_reaches(corners: Blocks, members: IndexRows, centres: Rows, axes: Blocks, reaches_out: BlocksOut) -> None:
    """Write the least and the largest reach of clusters from their centres along axes, (n, 2, 3) [m].

    `axes` (n, 3, 3) are three unit vectors, one a row, `centres` has shape (n, 3); the others are as in
    `cluster_spreads`.
    """
    away = np.empty(3)
    for cluster in range(members.shape[0]):
        for axis in range(3):
            reaches_out[cluster, 0, axis], reaches_out[cluster, 1, axis] = math.inf, -math.inf
        for i in range(members.shape[1]):
            for corner in range(3):
                for k in range(3):
                    away[k] = corners[members[cluster, i], corner, k] - centres[cluster, k]
                for axis in range(3):
                    along = axes[cluster, axis, 0] * away[0] + axes[cluster, axis, 1] * away[1]
                    along += axes[cluster, axis, 2] * away[2]
                    reaches_out[cluster, 0, axis] = min(reaches_out[cluster, 0, axis], along)
                    reaches_out[cluster, 1, axis] = max(reaches_out[cluster, 1, axis], along)
