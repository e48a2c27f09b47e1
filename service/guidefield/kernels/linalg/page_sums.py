"""Sums over the pages of a file, which tell whether any of it was altered: NH, two sums of products of its words.

Two contents of a page have the same two sums with a chance of 2^-64, whatever differs (J. Black et al., UMAC: Fast and
Secure Message Authentication, 1999). A processor finds them as fast as it reads.
"""

from __future__ import annotations

import numpy as np
from numba import types, void
from numpy.typing import NDArray

from guidefield.kernels.jit.signatures import exact_kernel

PAGE = 512
"""Words of a page."""

Words = NDArray[np.uint64]

_WORDS = types.Array(types.uint64, 1, "C", readonly=True)
_LOW, _HALF = np.uint64(2**32 - 1), np.uint64(32)


@exact_kernel(void(_WORDS, _WORDS, types.Array(types.uint64, 2, "C")))
def page_sums(words: Words, keys: Words, sums_out: Words) -> None:
    """Sum words page by page: the products of the halves of each, both shifted by a key's.

    Args:
        words: Shape (n,).
        keys: Shape (PAGE + 1,).
        sums_out: Gets two sums of each page, of which the last may be shorter; shape (pages, 2).
    """
    for page in range(sums_out.shape[0]):
        begin = page * PAGE
        first = second = np.uint64(0)
        for k in range(min(PAGE, words.shape[0] - begin)):
            word, one, other = words[begin + k], keys[k], keys[k + 1]
            low, high = word & _LOW, word >> _HALF
            first += ((low + one) & _LOW) * ((high + (one >> _HALF)) & _LOW)
            second += ((low + other) & _LOW) * ((high + (other >> _HALF)) & _LOW)
        sums_out[page, 0], sums_out[page, 1] = first, second
