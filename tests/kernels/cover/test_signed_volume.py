"""Volumes against NumPy's sums of determinants."""

from __future__ import annotations

import numpy as np
import pytest

from guidefield.kernels.cover.winding import TOGETHER, signed_volume


@pytest.mark.parametrize("count", [0, 1, TOGETHER, TOGETHER + 1, 5 * TOGETHER])
def test_it_is_a_sum_of_determinants(count: int) -> None:
    rng = np.random.default_rng(count)
    vertices, triangles, origin = rng.normal(size=(100, 3)), rng.integers(0, 100, (count, 3)), rng.normal(size=3)
    wanted = np.linalg.det(vertices[triangles] - origin).sum() / 6.0
    assert signed_volume(vertices, triangles, origin) == pytest.approx(wanted, rel=1e-9, abs=1e-9)
