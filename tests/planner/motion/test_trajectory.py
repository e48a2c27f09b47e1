"""The Hermite curve: its Bezier points, its samples, and several joined."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.planner.motion.trajectory import Trajectory, concatenate
from tests.knots import random_knots

SEEDS = st.integers(0, 2**32 - 1)


@settings(max_examples=12, deadline=None)
@given(seed=SEEDS)
def test_bezier_points_are_the_same_curve(seed):
    trajectory = Trajectory(*random_knots(seed))
    points, t = trajectory.bezier(), 0.37
    bernstein = np.array([(1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t), t**3])
    times = trajectory.times[:-1] + t * np.diff(trajectory.times)
    expected = trajectory.evaluate(times)[0]
    np.testing.assert_allclose(np.einsum("k,mkj->mj", bernstein, points), expected, atol=1e-12)


@pytest.mark.parametrize("rate", [1.0, 7.3, 50.0, 1000.0])
def test_resampling_is_uniform_and_includes_the_end(rate):
    trajectory = Trajectory(*random_knots(9))
    samples = trajectory.resample(rate)
    assert samples.times[0] == 0.0
    assert samples.times[-1] == trajectory.duration
    steps = np.diff(samples.times)
    np.testing.assert_allclose(steps[:-1], 1.0 / rate, rtol=1e-9)
    assert 0.0 < steps[-1] <= 1.0 / rate * (1 + 1e-9)
    for mine, expected in zip(
        (samples.positions, samples.velocities, samples.accelerations), trajectory.evaluate(samples.times), strict=True
    ):
        np.testing.assert_array_equal(mine, expected)


def test_joined_motions_are_each_where_they_were() -> None:
    rng = np.random.default_rng(1)
    first = Trajectory(np.array([0.0, 0.5, 1.0]), rng.normal(size=(3, 2)), rng.normal(size=(3, 2)))
    second = Trajectory(
        np.array([0.0, 2.0]), np.vstack([first.positions[-1:], rng.normal(size=(1, 2))]),
        np.vstack([first.velocities[-1:], rng.normal(size=(1, 2))]),
    )  # fmt: skip
    still = Trajectory(np.zeros(1), first.positions[:1], np.zeros((1, 2)))
    both = concatenate([still, first, second])
    assert both.duration == 3.0
    times = np.linspace(0.0, 1.0, 9)
    np.testing.assert_allclose(both.evaluate(times)[0], first.evaluate(times)[0], atol=1e-12)
    np.testing.assert_allclose(both.evaluate(1.0 + 2.0 * times)[0], second.evaluate(2.0 * times)[0], atol=1e-12)
