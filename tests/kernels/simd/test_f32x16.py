"""The vector of sixteen floats: every operation lane by lane against NumPy, on this processor and on plainer ones."""

from __future__ import annotations

import math
import os
import subprocess
import sys

import numpy as np
import pytest
from numba import njit

from guidefield.kernels.simd import f32x16
from guidefield.kernels.simd.lane_math import BOX, CAPSULE, CYLINDER, HALF_SPACE, cosine_and_sine, near_primitive

X, Y = np.random.default_rng(0).normal(size=(2, f32x16.LANES)).astype(np.float32)


@njit
def _arithmetic(x, y, out):
    x, y, out = f32x16.pointers(x), f32x16.pointers(y), f32x16.pointers(out)
    a, b = f32x16.load(x, 0), f32x16.load(y, 0)
    f32x16.store(out, 0, a + b)
    f32x16.store(out, 16, a - b)
    f32x16.store(out, 32, a * b)
    f32x16.store(out, 48, -a)
    f32x16.store(out, 64, 2.5 * a + 1.0 - y[0] * b)
    f32x16.store(out, 80, f32x16.sqrt(f32x16.magnitude(a)))
    f32x16.store(out, 96, f32x16.rint(a * 3.0))
    f32x16.store(out, 112, f32x16.smallest_of(a, b))
    f32x16.store(out, 128, f32x16.largest_of(a, b))
    f32x16.store(out, 144, f32x16.where_below(a, b, a * 10.0, f32x16.splat(7.0)))


@njit
def _masks(x, y):
    x, y = f32x16.pointers(x), f32x16.pointers(y)
    a, b = f32x16.load(x, 0), f32x16.load(y, 0)
    mask = f32x16.below(a, b)
    return mask, f32x16.first_lane(mask), f32x16.lane(a, 5), f32x16.largest_lane(a)


@njit
def _turned(x, out):
    x, out = f32x16.pointers(x), f32x16.pointers(out)
    c, s = cosine_and_sine(f32x16.load(x, 0))
    f32x16.store(out, 0, c)
    f32x16.store(out, 16, s)


@njit
def _near(kind, row, points, reach):
    row, points = f32x16.pointers(row), f32x16.pointers(points)
    return near_primitive(kind, row, 0, f32x16.load(points, 0), f32x16.load(points, 16), f32x16.load(points, 32), reach)


def check_arithmetic() -> None:
    out = np.zeros(160, np.float32)
    _arithmetic(X, Y, out)
    expected = [X + Y, X - Y, X * Y, -X, np.float32(2.5) * X + 1 - Y[0] * Y, np.sqrt(np.abs(X)), np.rint(X * 3)]
    expected += [np.minimum(X, Y), np.maximum(X, Y), np.where(X < Y, X * 10, np.float32(7))]
    np.testing.assert_allclose(out.reshape(10, 16), expected, rtol=1e-6, atol=1e-6)


def test_every_operation_is_numpys_lane_by_lane() -> None:
    check_arithmetic()


def test_masks_have_a_bit_for_each_lane() -> None:
    mask, first, fifth, largest = _masks(X, Y)
    bits = [(mask >> k) & 1 == 1 for k in range(f32x16.LANES)]
    np.testing.assert_array_equal(bits, X < Y)
    assert first == int(np.flatnonzero(X < Y)[0])
    assert fifth == X[5]
    assert largest == X.max()


def test_a_lane_that_is_not_a_number_is_below_everything() -> None:
    broken = X.copy()
    broken[3] = np.nan
    mask = _masks(broken, X - np.float32(1))[0]
    assert mask == 1 << 3


@pytest.mark.parametrize("reach", [1.0, math.pi, 10.0, 1000.0])
def test_cosine_and_sine(reach: float) -> None:
    rng, out = np.random.default_rng(1), np.zeros(32, np.float32)
    for _ in range(200):
        angles = rng.uniform(-reach, reach, f32x16.LANES).astype(np.float32)
        _turned(angles, out)
        np.testing.assert_allclose(out[:16], np.cos(angles.astype(float)), rtol=0.0, atol=5e-7)
        np.testing.assert_allclose(out[16:], np.sin(angles.astype(float)), rtol=0.0, atol=5e-7)


def _distance(kind: int, local: np.ndarray, halves: np.ndarray, radius: float) -> np.ndarray:
    """Distance of points (n, 3) in a primitive's own axes, 0 inside."""
    if kind == HALF_SPACE:
        return np.maximum(local[:, 2], 0.0)
    if kind == BOX:
        return np.linalg.norm(np.maximum(np.abs(local) - halves, 0.0), axis=1)
    if kind == CAPSULE:
        along = np.clip(local[:, 2], -halves[2], halves[2])
        return np.maximum(np.linalg.norm(local - along[:, None] * [0, 0, 1], axis=1) - radius, 0.0)
    across = np.maximum(np.hypot(local[:, 0], local[:, 1]) - radius, 0.0)
    return np.hypot(across, np.maximum(np.abs(local[:, 2]) - halves[2], 0.0))


@pytest.mark.parametrize("kind", [BOX, CYLINDER, CAPSULE, HALF_SPACE])
def test_points_near_a_primitive(kind: int) -> None:
    rng = np.random.default_rng(2)
    for _ in range(100):
        axes, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        centre, halves, radius = rng.normal(size=3), rng.uniform(0.1, 0.6, 3), float(rng.uniform(0.1, 0.4))
        points, reach = rng.normal(size=(16, 3)), float(rng.uniform(0.05, 0.8))
        row = np.array([*axes.ravel(), *centre, *halves, radius], np.float32)
        mask = _near(kind, row, points.T.astype(np.float32).ravel(), reach)
        apart = _distance(kind, (points - centre) @ axes.T, halves, radius)
        decided = np.abs(apart - reach) > 1e-5
        bits = np.array([(mask >> k) & 1 == 1 for k in range(16)])
        np.testing.assert_array_equal(bits[decided], (apart < reach)[decided])


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
