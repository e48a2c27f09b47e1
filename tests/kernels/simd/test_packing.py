"""Words that stand for tuples: what kernels read back; and a product that is rounded once."""

from fractions import Fraction
from typing import NamedTuple

import numba
import numpy as np
from numba import njit, types

from guidefield.kernels.simd.packing import fused, pack, pointers, unpacked

FLOATS = types.Array(types.float32, 1, "C", readonly=True)
NUMBERS = types.Array(types.int64, 1, "C")


class Inside(NamedTuple):
    floats: np.ndarray
    count: int


class Outside(NamedTuple):
    size: int
    inside: Inside
    numbers: np.ndarray


read = unpacked(types.NamedTuple([types.int64, types.NamedTuple([FLOATS, types.int64], Inside), NUMBERS], Outside))


@njit
def _everything(words):
    value = read(pointers(words))
    value.numbers[1] = 7
    return value.size, value.inside.floats[2], value.inside.count, value.numbers[0]


def test_a_kernel_reads_and_writes_what_was_packed() -> None:
    value = Outside(3, Inside(np.arange(5, dtype=np.float32) + 0.5, -4), np.array([11, 12]))
    assert _everything(pack(value)) == (3, 2.5, -4, 11)
    np.testing.assert_array_equal(value.numbers, [11, 7])


@numba.njit
def _fused(x: float, y: float, z: float) -> float:
    return fused(x, y, z)


def test_a_fused_product_is_rounded_once() -> None:
    rng = np.random.default_rng(0)
    rounded_twice = 0
    for x, y, z in rng.normal(size=(500, 3)).tolist():
        assert _fused(x, y, z) == float(Fraction(x) * Fraction(y) + Fraction(z))
        rounded_twice += _fused(x, y, z) != x * y + z
    assert rounded_twice > 50
