"""Deduplication of points by an open-addressing hash table over their bits."""

from __future__ import annotations

import numpy as np
from numba import types, uint64

from guidefield.kernels.jit.arrays import (
    IndexRows,
    IndexRowsOut,
    Indices,
    IndicesOut,
    Integers,
    Rows,
    WordRows,
)
from guidefield.kernels.jit.decorators import inlined, kernel


@kernel
def swept_pairs(low: Rows, high: Rows, ends: Indices, first: int, last: int, pairs_out: IndexRowsOut) -> int:
    """Write the overlapping pairs (m, 2) of boxes `first` to `last` - 1 and later ones; return their count.

    `low` and `high` (2, n) are the two coordinates across the sweep, `ends` (n,) is behind the last box that begins
    within each box along it.
    """
    count = 0
    for one in range(first, last):
        for other in range(one + 1, ends[one]):
            if (
                low[0, one] <= high[0, other]
                and low[0, other] <= high[0, one]
                and low[1, one] <= high[1, other]
                and low[1, other] <= high[1, one]
            ):
                pairs_out[count, 0], pairs_out[count, 1] = one, other
                count += 1
    return count


@inlined
def _root(labels: Integers, vertex: int) -> int:
    """The lowest vertex that a vertex is known to be connected with; ways there are halved (R. Tarjan)."""
    while labels[vertex] != vertex:
        labels[vertex] = labels[labels[vertex]]
        vertex = labels[vertex]
    return vertex


@kernel
def lowest_connected(simplices: IndexRows, labels_out: IndicesOut) -> None:
    """Write for each vertex the lowest one that edges or triangles `simplices` (n, k) connect it to, shape (count,)."""
    for vertex in range(labels_out.shape[0]):
        labels_out[vertex] = vertex
    for i in range(simplices.shape[0]):
        a = _root(labels_out, simplices[i, 0])
        for corner in range(1, simplices.shape[1]):
            b = _root(labels_out, simplices[i, corner])
            low, high = min(a, b), max(a, b)
            labels_out[high] = low
            a = low
    for vertex in range(labels_out.shape[0]):  # a label is never above its vertex, so that those before are final
        labels_out[vertex] = labels_out[labels_out[vertex]]


_WORDS = types.Array(types.uint64, 2, "C", readonly=True)

_FACTORS = (0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB)
"""Odd multipliers. Source: S. Vigna, SplitMix64, 2015."""


@inlined
def _hash(words: np.ndarray, i: int) -> int:
    value = words[i, 0] * uint64(_FACTORS[0])
    value = (value ^ (value >> uint64(29))) + words[i, 1]
    value *= uint64(_FACTORS[1])
    value = (value ^ (value >> uint64(32))) + words[i, 2]
    value *= uint64(_FACTORS[2])
    mixed: int = value ^ (value >> uint64(31))
    return mixed


@kernel
def merge_points(words: WordRows, place_out: IndicesOut, first_out: IndicesOut) -> int:
    """Find the distinct ones of points, given by their coordinates' bits (n, 3); return their count.

    Writes each point's place among the distinct ones, and the first point at each place, ascending; shapes (n,).
    """
    size = 16
    while size < 2 * words.shape[0]:
        size *= 2
    slots = np.full(size, -1, np.int64)
    count = 0
    for i in range(words.shape[0]):
        k = np.int64(_hash(words, i) & uint64(size - 1))
        while True:
            known = slots[k]
            if known < 0:
                slots[k] = count
                first_out[count] = i
                place_out[i] = count
                count += 1
                break
            j = first_out[known]
            if words[i, 0] == words[j, 0] and words[i, 1] == words[j, 1] and words[i, 2] == words[j, 2]:
                place_out[i] = known
                break
            k = (k + 1) & (size - 1)
    return count
