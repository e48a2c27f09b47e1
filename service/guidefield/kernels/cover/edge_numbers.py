"""Edges of triangles, numbered in the order of their vertices."""

from __future__ import annotations

import numpy as np
from numba import types, void

from guidefield.kernels.jit.signatures import INDEX_MATRIX, INDICES, INDICES_OUT, Integers, compiled, inlined

FEW = 32
"""So many numbers are sorted by insertion; a vertex of a surface seldom has more edges."""


@inlined
def _insert(keys: Integers, members: Integers, begin: int, end: int) -> None:
    """Sort some keys, and what belongs to them, by insertion."""
    for i in range(begin + 1, end):
        key, member, j = keys[i], members[i], i
        while j > begin and keys[j - 1] > key:
            keys[j], members[j] = keys[j - 1], members[j - 1]
            j -= 1
        keys[j], members[j] = key, member


@compiled(types.int64(INDEX_MATRIX, types.int64, INDICES_OUT))
def number_edges(triangles: Integers, vertices: int, numbers_out: Integers) -> int:
    """Number the edges by their lower vertex, then by the other one.

    Args:
        triangles: Shape (t, 3).
        vertices: How many vertices there are.
        numbers_out: Gets the number of each triangle's edges ab, bc, ca; shape (3 t,).

    Returns:
        How many edges there are.
    """
    sides = 3 * triangles.shape[0]
    starts = np.zeros(vertices + 1, np.int64)
    for side in range(sides):
        a, b = triangles[side // 3, side % 3], triangles[side // 3, (side + 1) % 3]
        starts[min(a, b) + 1] += 1
    for vertex in range(vertices):
        starts[vertex + 1] += starts[vertex]
    others, members, ends = np.empty(sides, np.int64), np.empty(sides, np.int64), starts[:-1].copy()
    for side in range(sides):
        a, b = triangles[side // 3, side % 3], triangles[side // 3, (side + 1) % 3]
        low, at = min(a, b), ends[min(a, b)]
        others[at], members[at] = max(a, b), side
        ends[low] = at + 1
    count = 0
    for vertex in range(vertices):
        begin, end = starts[vertex], starts[vertex + 1]
        if end - begin <= FEW:
            _insert(others, members, begin, end)
        else:
            order = np.argsort(others[begin:end], kind="mergesort")
            others[begin:end], members[begin:end] = others[begin:end][order], members[begin:end][order]
        for at in range(begin, end):
            if at > begin and others[at] != others[at - 1]:
                count += 1
            numbers_out[members[at]] = count
        if end > begin:
            count += 1
    return count


@compiled(void(INDEX_MATRIX, INDICES, INDICES_OUT, INDICES_OUT))
def count_ways(triangles: Integers, numbers: Integers, up_out: Integers, down_out: Integers) -> None:
    """Count how often edges are run through upwards, and downwards.

    Args:
        triangles: Shape (t, 3).
        numbers: Of their edges, as `number_edges` has them.
        up_out: All zero; gets how often each goes from its lower vertex to the other one, shape (edges,).
        down_out: All zero; gets how often it goes the other way.
    """
    for side in range(numbers.shape[0]):
        if triangles[side // 3, side % 3] < triangles[side // 3, (side + 1) % 3]:
            up_out[numbers[side]] += 1
        else:
            down_out[numbers[side]] += 1
