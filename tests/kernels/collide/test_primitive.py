"""Which of sixteen points are near a primitive, against its distance by NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from numba import njit

from guidefield.kernels.collide.primitive import BOX, CAPSULE, CYLINDER, HALF_SPACE, near_primitive
from guidefield.kernels.simd.packing import pointers
from guidefield.kernels.simd.vector import load


@njit
def _near(kind, row, points, reach):
    row, points = pointers(row), pointers(points)
    return near_primitive(kind, row, 0, load(points, 0), load(points, 16), load(points, 32), reach)


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
