"""Which balls contain which elements, and how far each ball has to reach for those that it has to contain.

An element is a small body that is contained in a ball if its corners are: triangles of a surface.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types, uint64, void

from guidefield.kernels.cover.greedy_set_cover import lowest
from guidefield.kernels.jit.signatures import INDICES_OUT, MATRIX, VECTOR_OUT, Floats, compiled, inlined, optimized

INTEGERS = types.Array(types.int64, 1, "C", readonly=True)
WORDS_OUT = types.Array(types.uint64, 2, "C")


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
    """Whether ball i contains element j."""
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
    """Whether none of rows `first` to `last` - 1 of `corners` is further from a point than the root of `square`."""
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


@compiled(void(MATRIX, MATRIX, INTEGERS, MATRIX, MATRIX, WORDS_OUT))
def contained(
    balls: Floats, corners: Floats, first: np.ndarray, bounds: Floats, blocks: Floats, bits_out: np.ndarray
) -> None:
    """Which elements are in which ball.

    Args:
        balls: Centre and radius, shape (n, 4) [m].
        corners: Corners of all elements, one element's together, shape (k, 3) [m].
        first: First corner of each element, and the number of all, shape (m + 1,).
        bounds: A ball about each element, shape (m, 4) [m]: most are decided by it.
        blocks: A ball about every 64 elements, shape (words, 4) [m]: still more are decided by it.
        bits_out: Shape (n, words), zeros; bit j of row i is set if ball i contains element j.
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
    """How far ball i has to reach for element j, which it contains [m]."""
    square = _reach_squared(balls[i, 0], balls[i, 1], balls[i, 2], corners, first[j], first[j + 1])
    reach: float = min(math.sqrt(square), balls[i, 3])
    return reach


@compiled(void(MATRIX, MATRIX, INTEGERS, MATRIX, MATRIX, VECTOR_OUT, INDICES_OUT))
def reaches(
    balls: Floats,
    corners: Floats,
    first: np.ndarray,
    bounds: Floats,
    blocks: Floats,
    radii_out: Floats,
    owners_out: np.ndarray,
) -> None:
    """Share elements out among balls that together contain them, so that the balls can shrink.

    A ball first reaches for the elements that no other contains. The others go to a ball that reaches them anyway, else
    to the one that has to grow least.

    Args:
        balls: Centre and radius, shape (n, 4) [m].
        corners: Corners of all elements, shape (k, 3) [m].
        first: First corner of each element, and the number of all, shape (m + 1,).
        bounds: A ball about each element, shape (m, 4) [m].
        blocks: A ball about every 64 elements, shape (words, 4) [m].
        radii_out: How far each ball reaches about its centre, shape (n,), at most its radius; 0 if for nothing [m].
        owners_out: Which ball each element went to, shape (m,); -1 if none contains it.
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
