"""Curves through given rows: the spline against scipy's, shares of limits against dense samples, places along them."""

import dataclasses

import numpy as np
import pytest
import scipy.interpolate
from hypothesis import given, settings, strategies as st

from guidefield.planner.motion.limit_load import measure_limit_shares
from guidefield.planner.motion.submitted_motion import CurveKind, SubmittedMotion, spline_rates
from guidefield.planner.motion.trajectory import Trajectory
from tests.robots import group

SEEDS = st.integers(0, 2**32 - 1)
ARM = group("panda")


def random_motion(seed: int, kind: CurveKind = CurveKind.HERMITE, knots: int = 12) -> SubmittedMotion:
    """A motion of the Panda from seed to seed, within and beyond its limits, from a time that isn't 0."""
    rng = np.random.default_rng(seed)
    times = 3.0 + np.cumsum(rng.uniform(0.05, 0.6, size=knots))
    positions = rng.uniform(ARM.lower, ARM.upper, size=(knots, ARM.nv))
    rows = np.arange(knots)
    match kind:
        case CurveKind.HERMITE:
            rates = rng.normal(size=positions.shape) * 3.0
        case CurveKind.SPLINE:
            rates = spline_rates(times, positions)
        case CurveKind.LINEAR | CurveKind.STEPS:
            return SubmittedMotion(kind, positions, rows, times)
        case CurveKind.QUINTIC:
            rates, rises = rng.normal(size=(2, *positions.shape)) * 3.0
            return SubmittedMotion(kind, positions, rows, times, rates, rises)
    return SubmittedMotion(kind, positions, rows, times, rates)


@settings(max_examples=18)
@given(seed=SEEDS, knots=st.integers(2, 30))
def test_the_spline_is_scipys(seed: int, knots: int) -> None:
    rng = np.random.default_rng(seed)
    times, positions = np.cumsum(rng.uniform(0.02, 1.0, size=knots)), rng.normal(size=(knots, 3))
    expected = scipy.interpolate.CubicSpline(times, positions, bc_type="not-a-knot")(times, 1)
    np.testing.assert_allclose(spline_rates(times, positions), expected, rtol=1e-9, atol=1e-9)


def test_a_spline_through_a_smooth_motion_is_off_by_the_fourth_power_of_the_step() -> None:
    def off(step: float) -> float:
        times = np.arange(0.0, 2.0 + step / 2, step)
        positions = np.column_stack([np.sin(3.0 * times), np.cos(2.0 * times)])
        curve, between = Trajectory(times, positions, spline_rates(times, positions)), times[:-1] + step / 2
        exact = np.column_stack([np.sin(3.0 * between), np.cos(2.0 * between)])
        return float(np.abs(curve.evaluate(between)[0] - exact).max())

    assert 10.0 < off(0.1) / off(0.05) < 25.0


@settings(max_examples=18)
@given(seed=SEEDS, kind=st.sampled_from([CurveKind.HERMITE, CurveKind.SPLINE]))
def test_shares_of_limits_are_those_of_dense_samples(seed: int, kind: CurveKind) -> None:
    motion = random_motion(seed, kind)
    uses = measure_limit_shares(motion, ARM, 100.0 * np.ones(ARM.nv))
    curve = motion.measured
    dense = np.unique(np.concatenate([np.linspace(curve.times[0], curve.times[-1], 40_001), curve.times]))
    positions, velocities, accelerations = curve.evaluate(dense)
    middle, half = 0.5 * (ARM.lower + ARM.upper), 0.5 * (ARM.upper - ARM.lower)
    for use, shares in (
        (uses.position, np.abs(positions - middle) / half),
        (uses.velocity, np.abs(velocities) / ARM.velocity_limits),
        (uses.acceleration, np.abs(accelerations) / ARM.acceleration_limits),
    ):
        sampled = float(shares.max())
        assert use.share == pytest.approx(sampled, rel=5e-3)
        assert use.share >= sampled * (1.0 - 1e-12)
        _, when = motion.along(use.piece, use.at)
        there = shares[np.abs(dense - when) < 2e-4, use.coordinate]
        assert there.max() == pytest.approx(use.share, rel=2e-2)
    if kind is CurveKind.HERMITE:
        assert uses.jerk.steps
        assert not uses.jerk.is_within
    else:
        jerks = np.abs(np.diff(accelerations, axis=0)).max() / (dense[1] - dense[0]) / 100.0
        assert uses.jerk.share == pytest.approx(jerks, rel=0.05)


@settings(max_examples=18)
@given(seed=SEEDS, kind=st.sampled_from(CurveKind), share=st.floats(0.0, 1.0))
def test_a_place_that_is_measured_is_found_along_the_rows(seed: int, kind: CurveKind, share: float) -> None:
    motion = random_motion(seed, kind)
    begin, end = motion.measured.times[[0, -1]]
    row, when = motion.along_measured(float(begin + share * (end - begin)))
    assert when is not None
    (measured,) = motion.measured.evaluate(np.array([begin + share * (end - begin)]))[0]
    (executed,) = motion.scheduled.evaluate(np.array([when]))[0]
    np.testing.assert_allclose(executed, measured, atol=1e-9)
    assert np.interp(row, motion.rows, motion.times) == pytest.approx(when)


@settings(max_examples=18)
@given(seed=SEEDS)
def test_straight_pieces_are_straight(seed: int) -> None:
    motion = random_motion(seed, CurveKind.LINEAR)
    straight = motion.scheduled
    times = np.random.default_rng(seed).uniform(motion.times[0], motion.times[-1], size=50)
    expected = np.column_stack([np.interp(times, motion.times, column) for column in motion.positions.T])
    np.testing.assert_allclose(straight.evaluate(times)[0], expected, atol=1e-12)
    untimed = dataclasses.replace(motion, times=None)
    np.testing.assert_array_equal(untimed.pieces, motion.pieces)
    places = untimed.measured.evaluate(np.linspace(*untimed.measured.times[[0, -1]], 200))[0]
    lines = np.diff(motion.positions, axis=0)
    for place in places:  # on some piece
        along = np.clip(np.einsum("ij,ij->i", place - motion.positions[:-1], lines) / (lines**2).sum(axis=1), 0.0, 1.0)
        gaps = np.linalg.norm(motion.positions[:-1] + along[:, None] * lines - place, axis=1)
        assert gaps.min() < 1e-9
