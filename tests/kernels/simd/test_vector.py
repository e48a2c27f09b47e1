"""Inverse square roots in lanes against NumPy's."""

from typing import Any

import numpy as np
import pytest
from numba import njit

from guidefield.kernels.simd.vector import inverse_root, lanes_of, load, store

PRECISIONS = pytest.mark.parametrize("kind", [np.float32, np.float64])


@njit
def inverse_roots(x: Any, out: Any) -> None:
    for i in range(0, x.shape[0], lanes_of(x)):
        store(out, i, inverse_root(load(x, i)))


@PRECISIONS
def test_inverse_roots_are_good_to_an_ulp_or_two(kind: type) -> None:
    x = (10.0 ** np.random.default_rng(2).uniform(-36.0, 36.0, 4096)).astype(kind)
    out = np.empty_like(x)
    inverse_roots(x, out)
    expected = 1.0 / np.sqrt(x.astype(np.longdouble))
    assert float(np.abs(out / expected - 1.0).max()) <= 2.0 * float(np.finfo(kind).eps)
