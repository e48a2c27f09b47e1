"""Few sets that together contain all elements, by the greedy choice.

Which elements a set contains is a row of bits, 64 to a word.
"""

from __future__ import annotations

import numpy as np
from numba import types, uint64

from guidefield.kernels.jit.signatures import INDICES_OUT, Integers, compiled, inlined

WORDS = types.Array(types.uint64, 2, "C", readonly=True)


@inlined
def ones(word: int) -> int:
    """How many bits of a word are set."""
    word = word - ((word >> uint64(1)) & uint64(0x5555555555555555))
    word = (word & uint64(0x3333333333333333)) + ((word >> uint64(2)) & uint64(0x3333333333333333))
    word = (word + (word >> uint64(4))) & uint64(0x0F0F0F0F0F0F0F0F)
    total: int = (word * uint64(0x0101010101010101)) >> uint64(56)
    return np.int64(total)  # type: ignore[return-value]


@inlined
def lowest(word: int) -> int:
    """Place of the lowest bit that is set."""
    return ones((word & (~word + uint64(1))) - uint64(1))


@compiled(types.int64(WORDS, INDICES_OUT))
def greedy_choice(bits: np.ndarray, chosen_out: Integers) -> int:
    """Sets that together contain every element that any set contains, the most fruitful first.

    A set's worth only falls while others are chosen, so that it is counted again only when it would be next.

    Args:
        bits: Which set contains which element, shape (n, words).
        chosen_out: Gets the chosen sets in order, shape (n,).

    Returns:
        How many there are.
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
