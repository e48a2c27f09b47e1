"""Curves are kept within limits: by their de Boor points smoothly, by their slopes without."""

import warnings

import numpy as np
import pytest
import scipy.interpolate
from hypothesis import given, settings, strategies as st

from guidefield.collision.certify.position_limits import excesses
from guidefield.planner.motion.jerk import parameterize_gently
from guidefield.planner.motion.spline import interpolate
from guidefield.planner.motion.timing import parameterize
from guidefield.planner.motion.within_limits import bezier, bounded_slopes, leaving, smoothly_within
from tests.planner.limit_attack import extremes

SEEDS = st.integers(0, 2**32 - 1)
VELOCITIES = np.array([2.2, 2.2, 2.6])
ACCELERATIONS = np.array([15.0, 7.5, 20.0])
SLIGHT = 1e-11
"""Rounding [rad]: a hundredth of what the certificate lets pass."""


def clamped_walk(seed: int, share: float = 0.15) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Waypoints of which many are at a limit, and the limits."""
    rng = np.random.default_rng(seed)
    walk = np.cumsum(rng.normal(size=(rng.integers(3, 30), 3)) * 0.08 + rng.normal(size=3) * 0.1, axis=0)
    lower, upper = walk.min(axis=0) + share * np.ptp(walk, axis=0), walk.max(axis=0) - share * np.ptp(walk, axis=0)
    return np.clip(walk, lower, upper), lower, upper


@settings(max_examples=60, deadline=None)
@given(seed=SEEDS)
def test_a_spline_keeps_its_limits_and_its_ends_and_is_smooth(seed):
    waypoints, lower, upper = clamped_walk(seed)
    spline = interpolate(waypoints, lower, upper)
    assert excesses(spline.bezier(), lower, upper)[0].max() <= SLIGHT
    np.testing.assert_array_equal(spline.waypoints[[0, -1]], waypoints[[0, -1]])
    s = np.linspace(0.0, spline.knots[-1], 500)
    q = spline.evaluate(s)[0]
    assert (q >= lower - SLIGHT).all()
    assert (q <= upper + SLIGHT).all()
    # the only C² cubic through its knots with its second derivatives at the ends is scipy's
    ends = [(2, spline.evaluate(spline.knots[[k]])[2][0]) for k in (0, -1)]
    smooth = scipy.interpolate.CubicSpline(spline.knots, spline.waypoints, bc_type=tuple(ends))
    np.testing.assert_allclose(smooth(s), q, atol=1e-9)


@settings(max_examples=60, deadline=None)
@given(seed=SEEDS)
def test_a_coordinate_that_keeps_its_limits_stays_bit_for_bit(seed):
    waypoints, lower, upper = clamped_walk(seed)
    natural, kept = interpolate(waypoints), interpolate(waypoints, lower, upper)
    left = (excesses(natural.bezier(), lower, upper)[0] > SLIGHT).any(axis=0)
    np.testing.assert_array_equal(kept.coefficients[:, :, ~left], natural.coefficients[:, :, ~left])
    np.testing.assert_array_equal(kept.waypoints[:, ~left], natural.waypoints[:, ~left])
    np.testing.assert_array_equal(kept.knots, natural.knots)


@settings(max_examples=40, deadline=None)
@given(seed=SEEDS, jerk=st.sampled_from([None, 40.0, 400.0]))
def test_the_timed_motion_keeps_every_limit_exactly(seed, jerk):
    waypoints, lower, upper = clamped_walk(seed)
    spline = interpolate(waypoints, lower, upper)
    if jerk is None:
        motion = parameterize(spline, VELOCITIES, ACCELERATIONS)
    else:
        motion = parameterize_gently(spline, VELOCITIES, ACCELERATIONS, np.full(3, jerk))
    low, high, speed, acceleration, steepness = extremes(motion.times, motion.positions, motion.velocities)
    assert (low >= lower - SLIGHT).all()
    assert (high <= upper + SLIGHT).all()
    assert (speed <= VELOCITIES * (1 + 1e-9)).all()
    assert (acceleration <= ACCELERATIONS * (1 + 1e-9)).all()
    np.testing.assert_array_equal(motion.positions[[0, -1]], waypoints[[0, -1]])
    assert (motion.velocities[[0, -1]] == 0.0).all()
    if jerk is not None:
        assert (steepness <= jerk * (1 + 1e-6)).all()
        steps = np.abs(np.diff(motion.evaluate(motion.times)[2], axis=0)) / np.diff(motion.times)[:, None]
        assert (steps <= jerk * (1 + 1e-6)).all()  # no step of the acceleration at a knot


def test_a_curve_that_all_but_stands_at_its_end_is_timed_without_a_warning():
    waypoints, lower, upper = clamped_walk(435886)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        motion = parameterize(interpolate(waypoints, lower, upper), VELOCITIES, ACCELERATIONS)
    assert motion.duration < 2.5


@settings(max_examples=60, deadline=None)
@given(seed=SEEDS)
def test_bounded_slopes_keep_a_curve_within(seed):
    rng = np.random.default_rng(seed)
    knots = np.cumsum(rng.uniform(0.01, 0.5, rng.integers(2, 12)))
    lower, upper = np.array([-1.0, -np.inf]), np.array([1.0, 0.5])
    values = np.clip(rng.normal(size=(len(knots), 2)), lower, upper)
    slopes = rng.normal(size=values.shape) * 5.0
    bounded = bounded_slopes(knots, values, slopes, lower, upper)
    assert excesses(bezier(knots, values, bounded), lower, upper)[0].max() <= 1e-13
    assert (np.abs(bounded) <= np.abs(slopes)).all()
    assert not leaving(knots, values, bounded, lower, upper).any()
    np.testing.assert_allclose(bounded_slopes(knots, values, 0.1 * bounded, lower, upper), 0.1 * bounded)


def test_a_smooth_curve_that_keeps_its_limits_is_left_as_it_is():
    waypoints, _, _ = clamped_walk(3)
    spline = interpolate(waypoints)
    slopes = spline.evaluate(spline.knots)[1]
    free = np.full(3, np.inf)
    values, rates = smoothly_within(spline.knots, spline.waypoints, slopes, -free, free)
    np.testing.assert_allclose(values, spline.waypoints, atol=1e-13)
    np.testing.assert_allclose(rates, slopes, atol=1e-11)


def test_keeping_limits_costs_no_time():
    shares = []
    for seed in range(20):
        waypoints, lower, upper = clamped_walk(seed)
        free, kept = interpolate(waypoints), interpolate(waypoints, lower, upper)
        without = parameterize(free, VELOCITIES, ACCELERATIONS).duration
        shares.append(parameterize(kept, VELOCITIES, ACCELERATIONS).duration / without)
    assert np.median(shares) < 1.0
    assert max(shares) < 1.05


def test_the_curve_through_fewer_than_three_waypoints_is_straight():
    spline = interpolate(np.array([[0.0, 0.0], [1.0, 2.0]]), np.zeros(2), np.array([1.0, 2.0]))
    assert spline.evaluate(spline.knots[-1:] / 2)[0][0] == pytest.approx([0.5, 1.0])
