"""Sums of pages against Python's whole numbers."""

from __future__ import annotations

import numpy as np
import pytest

from guidefield.kernels.linalg.page_sums import PAGE, page_sums

HALF = 2**32


def summed(words: list[int], keys: list[int]) -> int:
    """The sum of a page, by whole numbers without end."""
    pairs = zip(words, keys, strict=False)
    products = [((w % HALF + k % HALF) % HALF) * ((w // HALF + k // HALF) % HALF) for w, k in pairs]
    return sum(products) % HALF**2


@pytest.mark.parametrize("count", [0, 1, PAGE - 1, PAGE, PAGE + 1, 3 * PAGE + 7])
def test_sums_are_those_of_whole_numbers(count: int) -> None:
    rng = np.random.default_rng(count)
    words, keys = (rng.integers(0, 2**64, n, np.uint64) for n in (count, PAGE + 1))
    sums = np.empty((-(-count // PAGE), 2), np.uint64)
    page_sums(words, keys, sums)
    of_keys = keys.tolist()
    for page, (first, second) in enumerate(sums.tolist()):
        own = words[page * PAGE : (page + 1) * PAGE].tolist()
        assert first == summed(own, of_keys)
        assert second == summed(own, of_keys[1:])
