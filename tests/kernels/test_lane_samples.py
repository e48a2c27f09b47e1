"""Rotations drawn evenly."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numba import void

from guidefield.kernels.lane_math import Floats32
from guidefield.kernels.lane_samples import turn_evenly
from guidefield.kernels.lanes import FLOATS_OUT, lane_kernel, pointers
from guidefield.kernels.signatures import VECTOR, Floats


@lane_kernel(void(VECTOR, FLOATS_OUT))
def drawn(places: Floats, vectors_out: Floats32) -> None:
    for at in range(0, len(places), 3):
        turn_evenly(pointers(places), at, pointers(vectors_out))


def test_rotations_are_drawn_evenly() -> None:
    """Of an even distribution the mean of each entry of the matrices is 0, and of its square 1/3."""
    steps = 1.2207440846057596 ** -np.arange(1.0, 4.0)
    places, vectors = (np.arange(1.0, 4001.0)[:, None] * steps) % 1.0, np.empty(12000, np.float32)
    drawn(places.ravel(), vectors)
    rotations = vectors.reshape(-1, 3).astype(float)
    assert np.linalg.norm(rotations, axis=1).max() <= np.pi + 1e-4
    matrices = np.array([pin.exp3(vector) for vector in rotations])
    np.testing.assert_allclose(matrices.mean(axis=0), np.zeros((3, 3)), atol=0.01)
    np.testing.assert_allclose((matrices**2).mean(axis=0), np.full((3, 3), 1.0 / 3.0), atol=0.01)


def test_a_rotation_is_that_of_its_quaternion() -> None:
    rng = np.random.default_rng(0)
    places, vectors = rng.random((300, 3)), np.empty(900, np.float32)
    drawn(places.ravel(), vectors)
    for (u, v, w), vector in zip(places, vectors.reshape(-1, 3).astype(float), strict=True):
        inner, outer, a, b = (1.0 - u) ** 0.5, u**0.5, 2.0 * np.pi * v, 2.0 * np.pi * w
        turned = pin.Quaternion(outer * np.cos(b), inner * np.sin(a), inner * np.cos(a), outer * np.sin(b))
        np.testing.assert_allclose(pin.exp3(vector), turned.matrix(), atol=2e-4)
