"""Points at the same place become one: an open-addressing hash table over their bits."""

from __future__ import annotations

import numpy as np
from numba import types, uint64

from guidefield.kernels.jit.signatures import INDICES_OUT, Integers, compiled, inlined

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


@compiled(types.int64(_WORDS, INDICES_OUT, INDICES_OUT))
def merge_points(words: np.ndarray, place_out: Integers, first_out: Integers) -> int:
    """Find the distinct points of some.

    Args:
        words: The bits of the points' coordinates, shape (n, 3).
        place_out: Gets the place of each point among the distinct ones, shape (n,).
        first_out: Gets the first point at each place, ascending, shape (n,).

    Returns:
        How many distinct points there are.
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
