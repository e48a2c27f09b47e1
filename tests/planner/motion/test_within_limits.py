"""Curves are kept within limits: by their de Boor points smoothly, by their slopes without."""

import numpy as np
import scipy.interpolate
from hypothesis import given, settings, strategies as st

from guidefield.planner.schedule.schedule import bezier, bound_slopes, clamp_smoothly, find_leaving
from guidefield.prove.curve import excesses

SEEDS = st.integers(0, 2**32 - 1)
SLIGHT = 1e-11
"""Rounding [rad]: a hundredth of what the certificate lets pass."""


def clamped_walk(seed: int, share: float = 0.15) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Waypoints of which many are at a limit, and the limits."""
    rng = np.random.default_rng(seed)
    walk = np.cumsum(rng.normal(size=(rng.integers(3, 30), 3)) * 0.08 + rng.normal(size=3) * 0.1, axis=0)
    lower, upper = walk.min(axis=0) + share * np.ptp(walk, axis=0), walk.max(axis=0) - share * np.ptp(walk, axis=0)
    return np.clip(walk, lower, upper), lower, upper


def smooth_curve(waypoints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Knots, and the slopes there of the natural cubic spline through waypoints."""
    knots = np.arange(float(len(waypoints)))
    return knots, scipy.interpolate.CubicSpline(knots, waypoints, bc_type="natural")(knots, 1)


@settings(max_examples=18, deadline=None)
@given(seed=SEEDS)
def test_a_smooth_curve_brought_within_keeps_its_ends_and_is_smooth(seed):
    waypoints, lower, upper = clamped_walk(seed)
    knots, slopes = smooth_curve(waypoints)
    values, rates = clamp_smoothly(knots, waypoints, slopes, lower, upper)
    assert excesses(bezier(knots, values, rates), lower, upper)[0].max() <= SLIGHT
    np.testing.assert_array_equal(values[[0, -1]], waypoints[[0, -1]])
    # the only C² cubic through its knots with its slopes at the ends is scipy's
    smooth = scipy.interpolate.CubicSpline(knots, values, bc_type=((1, rates[0]), (1, rates[-1])))
    np.testing.assert_allclose(smooth(knots, 1), rates, atol=1e-9)


@settings(max_examples=18, deadline=None)
@given(seed=SEEDS)
def test_bounded_slopes_keep_a_curve_within(seed):
    rng = np.random.default_rng(seed)
    knots = np.cumsum(rng.uniform(0.01, 0.5, rng.integers(2, 12)))
    lower, upper = np.array([-1.0, -np.inf]), np.array([1.0, 0.5])
    values = np.clip(rng.normal(size=(len(knots), 2)), lower, upper)
    slopes = rng.normal(size=values.shape) * 5.0
    bounded = bound_slopes(knots, values, slopes, lower, upper)
    assert excesses(bezier(knots, values, bounded), lower, upper)[0].max() <= 1e-13
    assert (np.abs(bounded) <= np.abs(slopes)).all()
    assert not find_leaving(knots, values, bounded, lower, upper).any()
    np.testing.assert_allclose(bound_slopes(knots, values, 0.1 * bounded, lower, upper), 0.1 * bounded)
