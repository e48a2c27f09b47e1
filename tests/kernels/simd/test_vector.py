"""Vectors of sixteen floats behind pointers: every operation against NumPy, on this processor and on plainer ones."""

import os
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from numba import njit

from guidefield.kernels.simd.packing import pointers
from guidefield.kernels.simd.vector import (
    LANES,
    below,
    first_lane,
    inverse_root,
    lane,
    lane_count,
    largest_lane,
    largest_of,
    load,
    magnitude,
    rint,
    root,
    select,
    smallest_lane,
    smallest_of,
    splat,
    store,
)

X, Y = np.random.default_rng(0).normal(size=(2, LANES)).astype(np.float32)


@njit
def _arithmetic(x, y, out):
    x, y, out = pointers(x), pointers(y), pointers(out)
    a, b = load(x, 0), load(y, 0)
    store(out, 0, a + b)
    store(out, 16, a - b)
    store(out, 32, a * b)
    store(out, 48, -a)
    store(out, 64, 2.5 * a + 1.0 - y[0] * b)
    store(out, 80, root(magnitude(a)))
    store(out, 96, rint(a * 3.0))
    store(out, 112, smallest_of(a, b))
    store(out, 128, largest_of(a, b))
    store(out, 144, select(a < b, a * 10.0, splat(7.0)))


@njit
def _masks(x, y):
    x, y = pointers(x), pointers(y)
    a, b = load(x, 0), load(y, 0)
    mask = below(a, b)
    return mask, first_lane(mask), lane(a, 5), largest_lane(a), smallest_lane(a)


def check_arithmetic() -> None:
    out = np.zeros(160, np.float32)
    _arithmetic(X, Y, out)
    expected = [X + Y, X - Y, X * Y, -X, np.float32(2.5) * X + 1 - Y[0] * Y, np.sqrt(np.abs(X)), np.rint(X * 3)]
    expected += [np.minimum(X, Y), np.maximum(X, Y), np.where(X < Y, X * 10, np.float32(7))]
    np.testing.assert_allclose(out.reshape(10, 16), expected, rtol=1e-6, atol=1e-6)


def test_every_operation_is_numpys_lane_by_lane() -> None:
    check_arithmetic()


def test_masks_have_a_bit_for_each_lane() -> None:
    mask, first, fifth, largest, smallest = _masks(X, Y)
    bits = [(mask >> k) & 1 == 1 for k in range(LANES)]
    np.testing.assert_array_equal(bits, X < Y)
    assert first == int(np.flatnonzero(X < Y)[0])
    assert fifth == X[5]
    assert (largest, smallest) == (X.max(), X.min())


def test_a_lane_that_is_not_a_number_is_below_everything() -> None:
    broken = X.copy()
    broken[3] = np.nan
    mask = _masks(broken, X - np.float32(1))[0]
    assert mask == 1 << 3


@pytest.mark.parametrize("processor", ["haswell", "nehalem"])
def test_plainer_processors_run_the_same_source(processor: str, tmp_path) -> None:
    """AVX2, and SSE4.2 alone."""
    environment = {
        **os.environ,
        "NUMBA_CPU_NAME": processor,
        "NUMBA_CPU_FEATURES": "",
        "NUMBA_CACHE_DIR": str(tmp_path),
    }
    code = (
        "import importlib.util, sys\n"
        f"spec = importlib.util.spec_from_file_location('plain', {__file__!r})\n"
        "module = importlib.util.module_from_spec(spec)\n"
        "spec.loader.exec_module(module)\n"
        "module.check_arithmetic()\n"
        "registers = ''.join(module._arithmetic.inspect_asm().values())\n"
        f"assert 'zmm' not in registers and ('ymm' in registers) == ({processor!r} == 'haswell')\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr


PRECISIONS = pytest.mark.parametrize("kind", [np.float32, np.float64])


@njit
def inverse_roots(x: Any, out: Any) -> None:
    for i in range(0, x.shape[0], lane_count(x)):
        store(out, i, inverse_root(load(x, i)))


@PRECISIONS
def test_inverse_roots_are_good_to_an_ulp_or_two(kind: type) -> None:
    x = (10.0 ** np.random.default_rng(2).uniform(-36.0, 36.0, 4096)).astype(kind)
    out = np.empty_like(x)
    inverse_roots(x, out)
    expected = 1.0 / np.sqrt(x.astype(np.longdouble))
    assert float(np.abs(out / expected - 1.0).max()) <= 2.0 * float(np.finfo(kind).eps)
