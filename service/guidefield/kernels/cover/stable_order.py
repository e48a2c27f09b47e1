"""The order of whole numbers, of the same ones in that of their places: sorted by their digits."""

from __future__ import annotations

import numpy as np
from numba import void

from guidefield.kernels.jit.signatures import INDICES, INDICES_OUT, Integers, compiled

BITS = 11
"""Of a digit."""


@compiled(void(INDICES, INDICES_OUT))
def stable_order(numbers: Integers, order_out: Integers) -> None:
    """Sort numbers, the last digit first.

    Args:
        numbers: None is negative; shape (n,).
        order_out: Gets their places, the least number's first; shape (n,).
    """
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
