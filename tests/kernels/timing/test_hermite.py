"""The exact extrema of a Hermite curve against its roots and against dense samples."""

import numpy as np
from hypothesis import given, settings, strategies as st
from scipy.interpolate import CubicHermiteSpline

from guidefield.kernels.timing.hermite import largest_shares, piece_peaks, states_at
from tests.knots import random_knots


def peaks(kernel, times, positions, velocities):
    speeds, accelerations = np.full((2, len(times) - 1, positions.shape[1]), np.nan)
    kernel(times, positions, velocities, speeds, accelerations)
    return speeds, accelerations


@settings(max_examples=12)
@given(seed=st.integers(0, 2**32 - 1))
def test_no_sample_exceeds_them_and_one_reaches_them(seed):
    times, positions, velocities = random_knots(seed)
    curve = CubicHermiteSpline(times, positions, velocities)
    speeds, accelerations = peaks(piece_peaks, times, positions, velocities)
    for i in range(len(times) - 1):
        # a sample next to the right end: exactly there scipy evaluates the next piece
        inside = np.append(np.linspace(times[i], times[i + 1], 1000)[:-1], np.nextafter(times[i + 1], -1.0))
        turns = [r for c in range(3) for r in roots_between(curve, c, times[i], times[i + 1])]
        inside = np.concatenate([inside, turns])
        size_v, size_a = np.abs(curve(inside, 1)).max(axis=0), np.abs(curve(inside, 2)).max(axis=0)
        np.testing.assert_allclose(speeds[i], size_v, rtol=1e-9)
        np.testing.assert_allclose(accelerations[i], size_a, rtol=1e-9)


def roots_between(curve, coordinate, start, end):
    """Times strictly inside a piece at which a coordinate's acceleration vanishes, by linear interpolation."""
    a, b = curve(start, 2)[coordinate], curve(np.nextafter(end, start), 2)[coordinate]
    return [start + (end - start) * a / (a - b)] if a * b < 0.0 else []


@settings(max_examples=12)
@given(seed=st.integers(0, 2**32 - 1))
def test_shares_are_those_of_the_peaks_and_of_the_jerk_between_the_ends(seed):
    times, positions, velocities = random_knots(seed)
    limits = np.random.default_rng(seed).uniform(0.1, 9.0, (3, positions.shape[1]))
    limits[2, 0] = np.inf
    speeds, accelerations = peaks(piece_peaks, times, positions, velocities)
    jerks = CubicHermiteSpline(times, positions, velocities).c[0] * 6.0  # the third derivative is constant
    shares = np.full(3, np.nan)
    largest_shares(times, positions, velocities, *limits, shares)
    wanted = [(speeds / limits[0]).max(), (accelerations / limits[1]).max(), (np.abs(jerks) / limits[2]).max()]
    np.testing.assert_allclose(shares, wanted, rtol=1e-9)


@settings(max_examples=12)
@given(seed=st.integers(0, 2**32 - 1))
def test_states_are_those_of_the_curve_in_any_order_of_times(seed):
    times, positions, velocities = random_knots(seed)
    curve, rng = CubicHermiteSpline(times, positions, velocities), np.random.default_rng(seed)
    starts, jerks = curve(times[:-1], 2), curve(0.5 * (times[:-1] + times[1:]), 3)
    accelerations = np.concatenate([starts, np.full((1, 3), np.nan)])
    asked = rng.permutation(np.concatenate([times[:-1], rng.uniform(times[0], times[-1], 50)]))
    q, v, a = (np.full((len(asked), 3), np.nan) for _ in range(3))
    states_at(times, positions, velocities, accelerations, jerks, asked, q, v, a)
    for order, found in enumerate((q, v, a)):
        size = np.abs(curve(asked, order)).max()
        np.testing.assert_allclose(found, curve(asked, order), atol=1e-9 * max(size, 1.0))
    outside = np.array([times[0] - 1.0, times[-1], times[-1] + 1.0])
    q, v, a = (np.full((3, 3), np.nan) for _ in range(3))
    states_at(times, positions, velocities, accelerations, jerks, outside, q, v, a)
    np.testing.assert_array_equal(q, positions[[0, -1, -1]])
    np.testing.assert_array_equal([v[0], v[2], a[0], a[2]], 0.0)
