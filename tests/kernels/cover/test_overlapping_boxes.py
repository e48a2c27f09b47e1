"""A sweep finds the pairs of triangles that may cross, each once, and none that crosses is left out."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.geometry import crossings as module
from guidefield.geometry.crossings import crossings


@settings(deadline=None, max_examples=12)
@given(st.integers(2, 60), st.integers(1, 9), st.integers(0, 10**6))
def test_the_pairs_are_those_of_all_compared(count: int, slabs: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    corners = rng.normal(size=(count, 1, 3)) + rng.uniform(0.1, 1.5) * rng.normal(size=(count, 3, 3))
    vertices, triangles = corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)
    every = np.array([(i, j) for j in range(count) for i in range(j)])
    expected = every[module._cross(vertices - vertices.mean(axis=0), triangles, every, 1e-9)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "_IN_SLAB", -(-count // slabs))
        patch.setattr(module, "_CHUNK", 50)
        found = crossings(vertices, triangles)
    assert found.complete
    assert found.pairs.tolist() == sorted(expected.tolist())
