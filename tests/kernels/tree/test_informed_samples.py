"""Samples near a way and in a box, sixteen at a time, and rotations drawn evenly."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st
from numba import int64, types, void

from guidefield.kernels.jit.arrays import FLOATS, FLOATS_OUT, INDICES, VECTOR_OUT, Floats, Floats32
from guidefield.kernels.jit.compilers import kernel
from guidefield.kernels.simd.packing import Words, pack, pointers
from guidefield.kernels.simd.vector import LANES, load
from guidefield.kernels.tree.informed_samples import (
    NEAR,
    Sampling,
    Way,
    next_samples,
    pass_samples,
    sampling_of,
    turn_evenly,
)


@kernel(void(FLOATS, FLOATS_OUT))
def turned(shares: Floats32, vectors_out: Floats32) -> None:
    for at in range(0, len(shares), 3 * LANES):
        x, y, z = load(pointers(shares), at), load(pointers(shares), at + LANES), load(pointers(shares), at + 2 * LANES)
        turn_evenly(x, y, z, pointers(vectors_out), at)


@kernel(void(INDICES, VECTOR_OUT, FLOATS, types.float64, int64, types.Array(types.float32, 2, "C")))
def drawn(words: Words, places: Floats, ends: Floats32, reach: float, used: int, samples_out: Floats32) -> None:
    sampling, nv = sampling_of(pointers(words)), len(ends) // 2
    way = Way(pointers(ends), 0, nv, 1, reach)
    for batch in range(len(samples_out)):
        next_samples(sampling, nv, pointers(places), way, pointers(samples_out[batch]))
        pass_samples(sampling, nv, pointers(places), used)


def steps_of(count: int) -> np.ndarray:
    """Powers of the number whose multiples fill a box of so many sides evenly."""
    g = np.roots([1.0, *[0.0] * (count - 1), -1.0, -1.0])
    steps: np.ndarray = g[np.abs(g.imag) < 1e-9].real.max() ** -np.arange(1.0, count + 1.0)
    return steps


def sequence(
    lower: np.ndarray, width: np.ndarray, period: np.ndarray, ends: np.ndarray, reach: float, batches: int
) -> tuple[np.ndarray, np.ndarray]:
    """Samples (n, nv) near the way between two points (2, nv), and the places (n, nv + 1) they come from."""
    nv = len(lower)
    frequency = np.where(period > 0.0, 1.0 / np.where(period > 0.0, period, 1.0), 0.0).astype(np.float32)
    begin, samples = np.linspace(0.3, 0.7, nv + 1), np.empty((batches, nv * LANES), np.float32)
    sampling = Sampling(
        steps_of(nv + 1),
        lower,
        width,
        period.astype(np.float32),
        frequency,
        np.ones(nv, np.float32),
        0,
        np.zeros(0, np.int64),
    )
    drawn(pack(sampling), begin.copy(), ends.astype(np.float32).ravel(), reach, LANES, samples)
    places = (begin + np.arange(1.0, batches * LANES + 1.0)[:, None] * steps_of(nv + 1)) % 1.0
    return samples.reshape(-1, nv, LANES).transpose(0, 2, 1).reshape(-1, nv).astype(float), places


def vectors_of(places: np.ndarray) -> np.ndarray:
    """Rotation vectors of places (n, 3) in the unit cube, n a multiple of 16."""
    vectors = np.empty(places.size, np.float32)
    turned(places.reshape(-1, LANES, 3).transpose(0, 2, 1).astype(np.float32).ravel(), vectors)
    return vectors.reshape(-1, 3, LANES).transpose(0, 2, 1).reshape(-1, 3).astype(float)


@pytest.mark.parametrize("used", [16, 5])
def test_samples_go_on_where_the_last_that_was_used_is(used: int) -> None:
    """In the box: none is near the way where the last place stays beyond the share of those that are."""
    steps, lower, width = (
        np.array([0.75, 0.5, 0.3, 0.9, 0.0]),
        np.array([-1.0, 2.0, 0.0, -5.0]),
        np.array([2.0, 1.0, 3.0, 4.0]),
    )
    none = np.zeros(4, np.float32)
    sampling = Sampling(steps, lower, width, none, none, np.ones(len(lower), np.float32), 0, np.zeros(0, np.int64))
    begin, samples = np.array([0.1, 0.999, 0.0, 0.6, 0.9]), np.empty((40, 4 * LANES), np.float32)
    drawn(pack(sampling), begin.copy(), np.zeros(8, np.float32), 0.1, used, samples)
    which = used * np.arange(40)[:, None] + np.arange(1, LANES + 1)
    shares = ((begin + which[..., None] * steps) % 1.0)[..., :4]
    off = np.abs((samples.reshape(-1, 4, LANES).transpose(0, 2, 1) - lower) / width - shares)
    assert np.minimum(off, 1.0 - off).max() < 3e-6  # of the box a sample may be at either end


def test_rotations_of_samples_are_drawn_evenly() -> None:
    """The rotation is of the sample's own shares, whatever the box and the way."""
    steps = 1.2207440846057596 ** -np.arange(1.0, 7.0)
    box = np.full(5, -7.0), np.full(5, 3.0)
    none = np.zeros(5, np.float32)
    sampling = Sampling(steps, *box, none, none, np.ones(len(none), np.float32), 1, np.array([1]))
    samples = np.empty((1, 5 * LANES), np.float32)
    drawn(pack(sampling), np.zeros(6), np.full(10, -6.0, np.float32), 0.5, LANES, samples)
    shares, points = (np.arange(1.0, 17.0)[:, None] * steps) % 1.0, samples.reshape(5, LANES).T
    near = shares[:, 5] < NEAR
    assert 0 < near.sum() < LANES
    np.testing.assert_allclose(points[:, 1:4], vectors_of(shares[:, 1:4]), atol=1e-5)
    np.testing.assert_allclose(points[~near][:, [0, 4]], -7.0 + 3.0 * shares[~near][:, [0, 4]], atol=1e-5)
    np.testing.assert_allclose(points[near][:, [0, 4]], -6.5 + shares[near][:, [0, 4]], atol=1e-5)


TURN = 2.0 * np.pi


@settings(max_examples=12, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), reach=st.floats(0.05, 20.0))
def test_a_sample_is_within_reach_of_its_point_of_the_way_and_within_the_limits(seed: int, reach: float) -> None:
    """As NumPy has it in double precision: limits, a narrow part of a turn, and two whole turns, one's ends far out."""
    rng = np.random.default_rng(seed)
    lower = np.array([-3.0, 1.0, -0.4, -np.pi, -np.pi])
    width = np.array([6.0, 0.2, 1.5, TURN, TURN])
    period = np.array([0.0, 0.0, TURN, TURN, TURN])
    ends = lower + rng.random((2, 5)) * width
    ends[1, 3:] = ends[0, 3:] + rng.uniform(-3.0, 3.0, 2)
    far = ends + np.array([[0.0, 0.0, 0.0, 0.0, 4.0], [0.0, 0.0, 0.0, -1.0, 3.0]]) * TURN
    samples, places = sequence(lower, width, period, far, reach, 6)
    near = places[:, 5] < NEAR
    middles = ends[0] + (places[:, 5] / NEAR)[:, None] * (ends[1] - ends[0])
    reaches = np.where(near, reach, np.inf)[:, None]
    least, most = np.maximum(middles - reaches, lower), np.minimum(middles + reaches, lower + width)
    half = np.minimum(reaches, np.pi)
    least[:, 3:], most[:, 3:] = (middles - half)[:, 3:], (middles + half)[:, 3:]
    off = samples - least - places[:, :5] * (most - least)
    off[:, 2:] -= TURN * np.rint(off[:, 2:] / TURN)
    clear = (np.abs(places[:, 5] - NEAR) > 1e-4) & ((places > 1e-4) & (places < 1.0 - 1e-4)).all(axis=1)
    assert np.abs(off[clear]).max() < 2e-4
    assert (samples[:, :3] >= lower[:3] - 1e-5).all()
    assert (samples[:, :3] <= (lower + width)[:3] + 1e-5).all()


def test_a_fixed_share_of_samples_fills_the_limits_evenly_whatever_the_way() -> None:
    """Of even samples in a box as many are in each of its boxes of a third of each side."""
    lower, width = np.array([-3.0, 0.0, -np.pi]), np.array([6.0, 1.0, TURN])
    ends = np.array([[-2.9, 0.1, 0.3], [-2.8, 0.1, -0.3]])
    samples, places = sequence(lower, width, np.array([0.0, 0.0, TURN]), ends, 0.05, 2500)
    wide = places[:, 3] >= NEAR
    assert abs(wide.mean() - (1.0 - NEAR)) < 1e-3
    cells = np.floor(3.0 * (((samples[wide] - lower) / width) % 1.0)).astype(int)
    counts = np.bincount(cells @ np.array([9, 3, 1]), minlength=27)
    assert np.abs(counts / counts.mean() - 1.0).max() < 0.05
    along = np.histogram(places[~wide, 3] / NEAR, 10, (0.0, 1.0))[0]
    assert np.abs(along / along.mean() - 1.0).max() < 0.01


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
