"""The tree of a cloud: points halved again and again, then boxes about sixteen of them, and of those."""

from __future__ import annotations

import math

import numpy as np
from numba import types, void

from guidefield.kernels.distance.point_tree import NOWHERE
from guidefield.kernels.jit.signatures import (
    FLOATS_OUT,
    INDICES,
    MATRIX,
    MATRIX_OUT,
    Floats,
    Floats32,
    compiled,
    inlined,
)
from guidefield.kernels.simd.blocks import AROUND, BLOCK
from guidefield.kernels.simd.vector_model import LANES

_STACK = 64


@inlined
def _swap(points: Floats, a: int, b: int) -> None:
    for k in range(3):
        points[a, k], points[b, k] = points[b, k], points[a, k]


@compiled(void(MATRIX_OUT, types.int64, types.int64, types.int64, types.int64))
def _divide(points: Floats, begin: int, end: int, at: int, axis: int) -> None:
    """Order rows so that none before `at` is greater along an axis than any from there on (Hoare's selection)."""
    low, high = begin, end - 1
    while low < high:
        middle = (low + high) // 2
        a, b, c = points[low, axis], points[middle, axis], points[high, axis]
        pivot = max(min(a, b), min(max(a, b), c))
        i, j = low, high
        while i <= j:
            while points[i, axis] < pivot:
                i += 1
            while points[j, axis] > pivot:
                j -= 1
            if i <= j:
                _swap(points, i, j)
                i += 1
                j -= 1
        if at <= j:
            high = j
        elif at >= i:
            low = i
        else:
            return


@compiled(void(MATRIX_OUT))
def sort_for_tree(points: Floats) -> None:
    """Order points so that neighbours are together: each sixteen, each sixteen of those, and so on.

    Args:
        points: Shape (n, 3) [m]; sorted in place.
    """
    begins, ends = np.empty(_STACK, np.int64), np.empty(_STACK, np.int64)
    begins[0], ends[0], top = 0, points.shape[0], 1
    while top > 0:
        top -= 1
        begin, end = begins[top], ends[top]
        blocks = (end - begin + LANES - 1) // LANES
        if blocks <= 1:
            continue
        half = 1
        while 2 * half < blocks:
            half *= 2
        widest, axis = -1.0, 0
        for k in range(3):
            low, high = math.inf, -math.inf
            for i in range(begin, end):
                low, high = min(low, points[i, k]), max(high, points[i, k])
            if high - low > widest:
                widest, axis = high - low, k
        at = begin + half * LANES
        _divide(points, begin, end, at, axis)
        begins[top], ends[top] = begin, at
        begins[top + 1], ends[top + 1] = at, end
        top += 2


@compiled(void(MATRIX, INDICES, FLOATS_OUT, FLOATS_OUT))
def fill_tree(points: Floats, firsts: np.ndarray, points_out: Floats32, boxes_out: Floats32) -> None:
    """Write the tables of sorted points.

    Args:
        points: In that order, shape (n, 3) [m].
        firsts: As `LaneCloud` has them.
        points_out: Sixteen together, shape (BLOCK * blocks,).
        boxes_out: Boxes, shape (AROUND * blocks of all levels,).
    """
    count, size = points.shape[0], boxes_out.shape[0]
    for at in range(0, size, AROUND):
        boxes_out[at : at + AROUND // 2] = np.float32(math.inf)
        boxes_out[at + AROUND // 2 : at + AROUND] = np.float32(-math.inf)
    for i in range(points_out.shape[0] // 3):
        place = i // LANES * BLOCK + i % LANES
        for k in range(3):
            points_out[place + LANES * k] = points[i, k] if i < count else np.float32(NOWHERE)
    for i in range(count):
        block = i // LANES
        for level in range(1, firsts.shape[0]):
            at = (firsts[level] + block // LANES) * AROUND + block % LANES
            for k in range(3):
                low, high, here = at + LANES * k, at + LANES * (3 + k), np.float32(points[i, k])
                boxes_out[low] = min(boxes_out[low], here)
                boxes_out[high] = max(boxes_out[high], here)
            block //= LANES
