from __future__ import annotations

import numpy as np
import pytest

from guidefield.kernels.cover.pieces import stable_order


@pytest.mark.parametrize("largest", [1, 2, 2047, 2048, 10**6, 2**33, 2**62])
@pytest.mark.parametrize("count", [0, 1, 2, 500])
def test_it_is_numpys_stable_order(largest: int, count: int) -> None:
    numbers = np.random.default_rng(count).integers(0, largest, count)
    numbers[count // 2 :] = numbers[: count - count // 2]  # many are the same
    order = np.empty(count, np.int64)
    stable_order(numbers, order)
    assert (order == np.argsort(numbers, kind="stable")).all()
