"""The tree of a surface's triangles, level by level: balls about runs of them, and runs halved along a side."""

from __future__ import annotations

import math

import numpy as np
from numba import types, void

from guidefield.kernels.jit.signatures import (
    BLOCKS,
    INDICES,
    INDICES_OUT,
    MATRIX,
    MATRIX_OUT,
    VECTOR_OUT,
    Floats,
    Integers,
    compiled,
)


@compiled(void(BLOCKS, INDICES, INDICES, INDICES, MATRIX_OUT))
def balls_about_runs(corners: Floats, members: Integers, starts: Integers, sizes: Integers, balls_out: Floats) -> None:
    """Balls about runs of triangles: about the middle of the box about each.

    Args:
        corners: Of all triangles, shape (t, 3, 3) [m].
        members: Which triangles are in the runs, one run after the other, shape (m,).
        starts: Where each run begins, shape (n,).
        sizes: How many each has, shape (n,).
        balls_out: Centre and radius of each run's ball, shape (n, 4) [m].
    """
    for run in range(starts.shape[0]):
        first, last = starts[run], starts[run] + sizes[run]
        least_x = least_y = least_z = math.inf
        most_x = most_y = most_z = -math.inf
        for i in range(first, last):
            for corner in range(3):
                x, y, z = (
                    corners[members[i], corner, 0],
                    corners[members[i], corner, 1],
                    corners[members[i], corner, 2],
                )
                least_x, least_y, least_z = min(least_x, x), min(least_y, y), min(least_z, z)
                most_x, most_y, most_z = max(most_x, x), max(most_y, y), max(most_z, z)
        balls_out[run, 0] = 0.5 * (least_x + most_x)
        balls_out[run, 1] = 0.5 * (least_y + most_y)
        balls_out[run, 2] = 0.5 * (least_z + most_z)
        x, y, z, farthest = balls_out[run, 0], balls_out[run, 1], balls_out[run, 2], 0.0
        for i in range(first, last):
            for corner in range(3):
                a = corners[members[i], corner, 0] - x
                b = corners[members[i], corner, 1] - y
                c = corners[members[i], corner, 2] - z
                farthest = max(farthest, a * a + b * b + c * c)
        balls_out[run, 3] = math.sqrt(farthest)


@compiled(void(VECTOR_OUT, INDICES_OUT, types.int64, types.int64, types.int64))
def _divide(along: Floats, members: Integers, begin: int, end: int, at: int) -> None:
    """Order members so that none before `at` is greater along an axis than any from there on (Hoare's selection)."""
    low, high = begin, end - 1
    while low < high:
        a, b, c = along[low], along[(low + high) // 2], along[high]
        pivot = max(min(a, b), min(max(a, b), c))
        i, j = low, high
        while i <= j:
            while along[i] < pivot:
                i += 1
            while along[j] > pivot:
                j -= 1
            if i <= j:
                along[i], along[j] = along[j], along[i]
                members[i], members[j] = members[j], members[i]
                i += 1
                j -= 1
        if at <= j:
            high = j
        elif at >= i:
            low = i
        else:
            return


@compiled(void(MATRIX, INDICES, INDICES, INDICES_OUT))
def halve_runs(centres: Floats, starts: Integers, sizes: Integers, members: Integers) -> None:
    """Order the members of runs, so that the first half of each is on one side of the other along its widest side.

    Args:
        centres: Of all triangles, shape (t, 3) [m].
        starts: Where each run begins, shape (n,).
        sizes: How many each has, shape (n,).
        members: Which triangles are in the runs, shape (m,); sorted in place.
    """
    along = np.empty(members.shape[0])
    for run in range(starts.shape[0]):
        first, last = starts[run], starts[run] + sizes[run]
        least_x = least_y = least_z = math.inf
        most_x = most_y = most_z = -math.inf
        for i in range(first, last):
            x, y, z = centres[members[i], 0], centres[members[i], 1], centres[members[i], 2]
            least_x, least_y, least_z = min(least_x, x), min(least_y, y), min(least_z, z)
            most_x, most_y, most_z = max(most_x, x), max(most_y, y), max(most_z, z)
        wide, deep, tall = most_x - least_x, most_y - least_y, most_z - least_z
        axis = 0 if wide >= deep and wide >= tall else 1 if deep >= tall else 2
        for i in range(first, last):
            along[i] = centres[members[i], axis]
        _divide(along, members, first, last, first + sizes[run] // 2)
