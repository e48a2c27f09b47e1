"""A sweep finds the pairs of boxes that overlap, each once."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings, strategies as st

from guidefield.kernels.cover.merge_points import swept_pairs


@settings(deadline=None, max_examples=12)
@given(st.integers(1, 40), st.integers(0, 10**6))
def test_the_pairs_are_those_of_all_compared(count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    low = np.round(rng.normal(size=(count, 3)), 1)
    low = low[np.argsort(low[:, 0], kind="stable")]
    high = low + np.round(rng.uniform(0.0, 1.0, (count, 3)), 1)
    ends = np.searchsorted(low[:, 0], high[:, 0], side="right")
    first, last = sorted(rng.integers(0, count + 1, 2).tolist())
    pairs = np.empty((count * count, 2), np.int64)
    across = [np.ascontiguousarray(corner[:, 1:].T) for corner in (low, high)]
    found = pairs[: swept_pairs(*across, ends, first, last, pairs)].tolist()
    overlap = ((low[:, None] <= high[None]) & (low[None] <= high[:, None])).all(axis=2)
    assert found == [[i, j] for i in range(first, last) for j in range(i + 1, count) if overlap[i, j]]
