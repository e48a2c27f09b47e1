"""Pairs of boxes that overlap, by a sweep in the order of their lower ends."""

from __future__ import annotations

from numba import types

from guidefield.kernels.jit.signatures import INDICES, MATRIX, Floats, Integers, compiled


@compiled(types.int64(MATRIX, MATRIX, INDICES, types.int64, types.int64, types.Array(types.int64, 2, "C")))
def swept_pairs(low: Floats, high: Floats, ends: Integers, first: int, last: int, pairs_out: Integers) -> int:
    """Write the pairs of some boxes and later ones whose boxes overlap across the sweep.

    Args:
        low: The two coordinates across of the lower corners, shape (2, n) [m].
        high: Those of the upper corners, shape (2, n) [m].
        ends: Behind the last box that begins within each box along the sweep, shape (n,).
        first: The first box that is compared with those behind it.
        last: The one behind the last of them.
        pairs_out: Gets the pairs, the earlier one first; shape (m, 2), enough for all.

    Returns:
        How many there are.
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
