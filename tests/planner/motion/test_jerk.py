"""Timing with jerk limits: every limit, the curve, rest at the ends, against closed forms and dense samples."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.planner.motion.jerk import parameterize_gently
from guidefield.planner.motion.spline import interpolate
from guidefield.planner.motion.timing import parameterize
from tests.planner.motion.test_timing import ACCELERATIONS, ANY_WAYPOINTS, VELOCITIES, even, walk


def gently(waypoints: np.ndarray, jerk: float):
    nv = waypoints.shape[1]
    return parameterize_gently(interpolate(waypoints), VELOCITIES[:nv], ACCELERATIONS[:nv], np.full(nv, jerk))


def assert_within(motion, jerk: float) -> None:
    nv = motion.positions.shape[1]
    times = np.unique(np.linspace(motion.times[:-1], motion.times[1:], 11))
    _, v, a = motion.evaluate(times)
    assert (np.abs(v) <= VELOCITIES[:nv] * (1 + 1e-6)).all()
    assert (np.abs(a) <= ACCELERATIONS[:nv] * (1 + 1e-6)).all()
    # accelerations are continuous: what they change by between two moments is what jerk allows
    changes = np.abs(np.diff(a, axis=0)) / np.diff(times)[:, None]
    assert (changes <= jerk * (1 + 1e-5) + 1e-6).all()


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("jerk", [20.0, 200.0, 5000.0])
def test_limits_hold_between_the_knots_and_the_curve_is_kept(seed, jerk):
    for waypoints in (walk(seed), even(seed)):
        motion = gently(waypoints, jerk)
        assert_within(motion, jerk)
        for ends in (motion.velocities[[0, -1]], motion.accelerations[[0, -1]]):
            np.testing.assert_allclose(ends, 0.0, atol=1e-7)
        np.testing.assert_array_equal(motion.positions[[0, -1]], waypoints[[0, -1]])
        spline = interpolate(waypoints)
        curve = spline.evaluate(np.linspace(0.0, spline.knots[-1], 40_000))[0]
        for q in motion.evaluate(np.linspace(0.0, motion.duration, 60))[0]:
            assert np.abs(curve - q).max(axis=1).min() < 3e-3
        assert motion.duration > 0.999 * parameterize(spline, VELOCITIES, ACCELERATIONS).duration


def test_a_straight_motion_takes_little_longer_than_it_must():
    """From rest to rest over a distance d with jerk alone: 4 (d / 2 j)^(1/3), in four ramps."""
    distance, jerk = 0.5, 4.0
    motion = parameterize_gently(
        interpolate(np.array([[0.0], [distance]])), np.array([1e3]), np.array([1e3]), np.array([jerk])
    )
    least = 4.0 * np.cbrt(distance / (2.0 * jerk))
    assert least * (1 - 1e-9) < motion.duration < 1.35 * least


def test_loose_limits_cost_little():
    waypoints = even(1)
    motion = gently(waypoints, 1e5)
    optimal = parameterize(interpolate(waypoints), VELOCITIES, ACCELERATIONS)
    assert motion.duration < 1.1 * optimal.duration


def test_a_joint_without_a_limit_has_none():
    waypoints = even(0)
    some = np.full(7, np.inf)
    some[2] = 10.0
    motion = parameterize_gently(interpolate(waypoints), VELOCITIES, ACCELERATIONS, some)
    changes = np.abs(np.diff(motion.accelerations, axis=0)) / np.diff(motion.times)[:, None]
    assert changes[:, 2].max() <= 10.0 * (1 + 1e-5)


@settings(deadline=None, max_examples=25)
@given(ANY_WAYPOINTS, st.floats(1.0, 1e4))
def test_any_path_keeps_any_limits(waypoints, jerk):
    motion = gently(waypoints, jerk)
    if len(motion.times) > 1:
        assert_within(motion, jerk)


def test_a_limit_that_is_none_is_refused():
    for wrong in (np.zeros(7), np.full(6, 1.0), np.full(7, np.nan)):
        with pytest.raises(ValueError, match="jerk"):
            parameterize_gently(interpolate(even(0)), VELOCITIES, ACCELERATIONS, wrong)
