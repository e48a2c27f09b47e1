"""Samples near a way and in a box, sixteen at a time."""

import numpy as np
from hypothesis import given, settings, strategies as st
from numba import int64, types, void

from guidefield.kernels.jit.arrays import FLOATS, INDICES, VECTOR_OUT, Floats, Floats32
from guidefield.kernels.jit.decorators import make_kernel as kernel
from guidefield.kernels.simd.packing import Words, pack, pointers
from guidefield.kernels.simd.vector import LANES
from guidefield.kernels.tree.informed_samples import NEAR, Sampling, Way, next_samples, pass_samples, sampling_of


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
    return g[np.abs(g.imag) < 1e-9].real.max() ** -np.arange(1.0, count + 1.0)


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


TURN = 2.0 * np.pi


@settings(max_examples=12)
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
