"""From rest to rest: each limit is reached by one coordinate or none, none is exceeded, and it is at rest at points."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.planner.motion.limit_load import limit_load
from guidefield.planner.motion.profiles import CUBIC, LEAST_JERK, SHORTEST, Profile, profile_of
from guidefield.planner.motion.timing import Limits

rate = st.floats(0.1, 30.0)
ends = st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6)


@settings(max_examples=15, deadline=None)
@given(ends, rate, rate, st.floats(1.0, 5000.0), st.booleans())
def test_it_is_as_fast_as_its_limits_allow(z: list[float], v: float, a: float, j: float, limited: bool) -> None:
    limits = Limits(np.full(3, v), np.full(3, a), np.array([j, np.inf, j]) if limited else np.full(3, np.inf))
    profile, points = profile_of(limits), np.array(z).reshape(2, 3)
    assert profile is (LEAST_JERK if limited else CUBIC)
    lasts = profile.duration(points[0], points[1], limits, 1.0)
    motion = profile.through(points, np.array([2.0, 2.0 + lasts]))
    np.testing.assert_array_equal(motion.positions[[0, -1]], points)
    load = limit_load(motion.times - 2.0, motion.positions, motion.velocities, *limits[:3])
    assert load <= 1.0 + 1e-6
    assert lasts == SHORTEST or load == pytest.approx(1.0, abs=1e-6)
    half = profile.duration(points[0], points[1], limits, 0.5)
    assert lasts == SHORTEST or half == pytest.approx(2.0 * lasts)


@pytest.mark.parametrize("profile", [CUBIC, LEAST_JERK])
def test_its_largest_rates_are_those_of_dense_samples(profile: Profile) -> None:
    motion = profile.through(np.array([[0.0], [1.0]]), np.array([0.0, 1.0]))
    _, v, a = motion.evaluate(np.linspace(0.0, 1.0, 100_001))
    assert np.abs(v).max() == pytest.approx(profile.velocity, rel=1e-9)
    assert np.abs(a).max() == pytest.approx(profile.acceleration, rel=1e-9)
    jumps = np.abs(np.diff(a[:, 0])).max() / 1e-5
    assert jumps == pytest.approx(profile.jerk, rel=1e-4) if np.isfinite(profile.jerk) else np.abs(a[0, 0]) > 0.0


@pytest.mark.parametrize("profile", [CUBIC, LEAST_JERK])
def test_it_waits_where_a_point_comes_twice(profile: Profile) -> None:
    points, times = np.array([[0.0, 1.0], [0.5, 0.0], [0.5, 0.0], [1.0, 1.0]]), np.array([0.0, 1.0, 3.0, 4.5])
    motion = profile.through(points, times)
    at = np.searchsorted(motion.times, times)
    np.testing.assert_array_equal(motion.times[at], times)
    np.testing.assert_array_equal(at, profile.pieces * np.arange(4))
    np.testing.assert_array_equal(motion.positions[at], points)
    q, v, _ = motion.evaluate(np.linspace(1.0, 3.0, 21))
    np.testing.assert_array_equal(q, np.repeat(points[1:2], 21, axis=0))
    assert not v.any()
