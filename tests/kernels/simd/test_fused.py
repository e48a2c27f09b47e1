from fractions import Fraction

import numba
import numpy as np

from guidefield.kernels.simd.packing import fused


@numba.njit
def _fused(x: float, y: float, z: float) -> float:
    return fused(x, y, z)


def test_it_is_rounded_once() -> None:
    rng = np.random.default_rng(0)
    rounded_twice = 0
    for x, y, z in rng.normal(size=(500, 3)).tolist():
        assert _fused(x, y, z) == float(Fraction(x) * Fraction(y) + Fraction(z))
        rounded_twice += _fused(x, y, z) != x * y + z
    assert rounded_twice > 50
