"""Samples in a box, sixteen at a time, and rotations drawn evenly."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from numba import int64, types, void

from guidefield.kernels.lane_math import Floats32
from guidefield.kernels.lane_samples import Sampling, next_samples, pass_samples, sampling_of, turn_evenly
from guidefield.kernels.lanes import FLOATS, FLOATS_OUT, LANES, lane_kernel, load, pointers
from guidefield.kernels.packing import Words, packed
from guidefield.kernels.signatures import VECTOR_OUT, Floats
from guidefield.kernels.tree_kinematics import INDICES


@lane_kernel(void(FLOATS, FLOATS_OUT))
def turned(shares: Floats32, vectors_out: Floats32) -> None:
    for at in range(0, len(shares), 3 * LANES):
        x, y, z = load(pointers(shares), at), load(pointers(shares), at + LANES), load(pointers(shares), at + 2 * LANES)
        turn_evenly(x, y, z, pointers(vectors_out), at)


@lane_kernel(void(INDICES, int64, VECTOR_OUT, int64, types.Array(types.float32, 2, "C")))
def drawn(words: Words, nv: int, places: Floats, used: int, samples_out: Floats32) -> None:
    sampling = sampling_of(pointers(words))
    for batch in range(len(samples_out)):
        next_samples(sampling, nv, pointers(places), pointers(samples_out[batch]))
        pass_samples(sampling, nv, pointers(places), used)


def vectors_of(places: np.ndarray) -> np.ndarray:
    """Rotation vectors of places (n, 3) in the unit cube, n a multiple of 16."""
    vectors = np.empty(places.size, np.float32)
    turned(places.reshape(-1, LANES, 3).transpose(0, 2, 1).astype(np.float32).ravel(), vectors)
    return vectors.reshape(-1, 3, LANES).transpose(0, 2, 1).reshape(-1, 3).astype(float)


@pytest.mark.parametrize("used", [16, 5])
def test_samples_go_on_where_the_last_that_was_used_is(used: int) -> None:
    steps, lower, width = (
        np.array([0.75, 0.5, 0.3, 0.9]),
        np.array([-1.0, 2.0, 0.0, -5.0]),
        np.array([2.0, 1.0, 3.0, 4.0]),
    )
    none = np.zeros(4, np.float32)
    sampling = Sampling(steps, lower, width, none, none, 0, np.zeros(0, np.int64))
    begin, samples = np.array([0.1, 0.999, 0.0, 0.6]), np.empty((40, 4 * LANES), np.float32)
    drawn(packed(sampling), 4, begin.copy(), used, samples)
    which = used * np.arange(40)[:, None] + np.arange(1, LANES + 1)
    shares = (begin + which[..., None] * steps) % 1.0
    off = np.abs((samples.reshape(-1, 4, LANES).transpose(0, 2, 1) - lower) / width - shares)
    assert np.minimum(off, 1.0 - off).max() < 3e-6  # of the box a sample may be at either end


def test_rotations_of_samples_are_drawn_evenly() -> None:
    """The rotation is of the sample's own shares, whatever the box."""
    steps = 1.2207440846057596 ** -np.arange(1.0, 6.0)
    box = np.full(5, -7.0), np.full(5, 3.0)
    none = np.zeros(5, np.float32)
    sampling = Sampling(steps, *box, none, none, 1, np.array([1]))
    samples = np.empty((1, 5 * LANES), np.float32)
    drawn(packed(sampling), 5, np.zeros(5), LANES, samples)
    shares, points = (np.arange(1.0, 17.0)[:, None] * steps) % 1.0, samples.reshape(5, LANES).T
    np.testing.assert_allclose(points[:, 1:4], vectors_of(shares[:, 1:4]), atol=1e-5)
    np.testing.assert_allclose(points[:, [0, 4]], -7.0 + 3.0 * shares[:, [0, 4]], atol=1e-5)


def test_rotations_are_drawn_evenly() -> None:
    """Of an even distribution the mean of each entry of the matrices is 0, and of its square 1/3."""
    steps = 1.2207440846057596 ** -np.arange(1.0, 4.0)
    rotations = vectors_of((np.arange(1.0, 4001.0)[:, None] * steps) % 1.0)
    assert np.linalg.norm(rotations, axis=1).max() <= np.pi + 1e-4
    matrices = np.array([pin.exp3(vector) for vector in rotations])
    np.testing.assert_allclose(matrices.mean(axis=0), np.zeros((3, 3)), atol=0.01)
    np.testing.assert_allclose((matrices**2).mean(axis=0), np.full((3, 3), 1.0 / 3.0), atol=0.01)


def test_a_rotation_is_that_of_its_quaternion() -> None:
    rng = np.random.default_rng(0)
    places = rng.random((304, 3))
    for (u, v, w), vector in zip(places, vectors_of(places), strict=True):
        inner, outer, a, b = (1.0 - u) ** 0.5, u**0.5, 2.0 * np.pi * v, 2.0 * np.pi * w
        turned = pin.Quaternion(outer * np.cos(b), inner * np.sin(a), inner * np.cos(a), outer * np.sin(b))
        np.testing.assert_allclose(pin.exp3(vector), turned.matrix(), atol=2e-4)
