"""Time-optimal timing against toppra and against closed forms; the limits against dense samples."""

import numpy as np
import pytest
import toppra
from hypothesis import example, given, settings, strategies as st
from hypothesis.extra import numpy as arrays
from scipy.interpolate import CubicSpline as ScipySpline

from guidefield.planner.motion.spline import interpolate
from guidefield.planner.motion.timing import parameterize

# Those of a Panda, accelerations halved.
VELOCITIES = np.array([2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61])
ACCELERATIONS = np.array([7.5, 3.75, 5.0, 6.25, 7.5, 10.0, 10.0])

SEEDS = st.integers(0, 2**32 - 1)
ANY_WAYPOINTS = arrays.arrays(
    float, st.tuples(st.integers(2, 9), st.integers(1, 4)), elements=st.floats(-4.0, 4.0, width=32)
)
# What rounding may add when a motion is evaluated between its knots.
ROUNDING = 1e-9


def walk(seed, n=10):
    """Waypoints with a corner at each."""
    return np.cumsum(np.random.default_rng(seed).normal(size=(n, 7)) * 0.3, axis=0)


def even(seed, n=32):
    """Evenly spaced waypoints on a curve that bends slowly."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, 1.0, n)[:, None]
    return rng.normal(size=7) + t * rng.normal(size=7) + np.sin(np.pi * t) * rng.normal(size=7) * 0.3


def timed(waypoints):
    nv = waypoints.shape[1]
    return parameterize(interpolate(waypoints), VELOCITIES[:nv], ACCELERATIONS[:nv])


def analytic_duration(distance, velocity, acceleration):
    """From rest to rest over a distance: bang-bang, or with a stretch at full speed."""
    if distance <= velocity**2 / acceleration:
        return 2.0 * np.sqrt(distance / acceleration)
    return distance / velocity + velocity / acceleration


def toppras_duration(waypoints, steps_a_piece):
    spline = interpolate(waypoints)
    path = toppra.SplineInterpolator(spline.knots, spline.waypoints, bc_type="natural")
    limits = [
        toppra.constraint.JointVelocityConstraint(np.stack([-VELOCITIES, VELOCITIES], axis=1)),
        toppra.constraint.JointAccelerationConstraint(
            np.stack([-ACCELERATIONS, ACCELERATIONS], axis=1),
            discretization_scheme=toppra.constraint.DiscretizationType.Interpolation,
        ),
    ]
    grid = np.unique(np.linspace(spline.knots[:-1], spline.knots[1:], steps_a_piece + 1))
    plan = toppra.algorithm.TOPPRA(limits, path, gridpoints=grid, parametrizer="ParametrizeConstAccel")
    return plan.compute_trajectory(0, 0).duration


def assert_within_limits(trajectory, samples_a_piece=10):
    nv = trajectory.positions.shape[1]
    times = np.unique(np.linspace(trajectory.times[:-1], trajectory.times[1:], samples_a_piece + 1))
    _, v, a = trajectory.evaluate(times)
    assert (np.abs(v) <= VELOCITIES[:nv] * (1 + ROUNDING)).all()
    assert (np.abs(a) <= ACCELERATIONS[:nv] * (1 + ROUNDING)).all()


@pytest.mark.parametrize("seed", range(6))
def test_is_as_fast_as_toppra(seed):
    waypoints = walk(seed)
    assert 0.99 < timed(waypoints).duration / toppras_duration(waypoints, 40) < 1.02


@pytest.mark.parametrize("seed", range(6))
def test_is_as_fast_as_toppra_on_even_paths(seed):
    waypoints = even(seed)
    assert 0.998 < timed(waypoints).duration / toppras_duration(waypoints, 16) < 1.005


@pytest.mark.parametrize("distance", [1e-6, 1e-3, 0.05, 0.3, 1.0, 5.0])
@pytest.mark.parametrize("pieces", [1, 3, 20])
def test_a_straight_motion_takes_the_analytic_time(distance, pieces):
    waypoints = np.zeros((pieces + 1, 7))
    waypoints[:, 2] = np.linspace(0.5, 0.5 + distance, pieces + 1)
    expected = analytic_duration(distance, VELOCITIES[2], ACCELERATIONS[2])
    duration = timed(waypoints).duration
    assert expected * (1 - ROUNDING) <= duration <= 1.005 * expected


def test_unevenly_spaced_waypoints_on_a_line_cost_little():
    direction = walk(1, 2)[1]
    shares = np.array([0.0, 0.2, 0.21, 0.5, 0.55, 0.555, 0.9, 1.0])
    duration = timed(shares[:, None] * direction).duration
    assert duration <= 1.01 * timed(np.array([0.0 * direction, direction])).duration


@settings(max_examples=20, deadline=None)
@given(seed=SEEDS)
def test_leaves_the_spline_by_less_than_a_milliradian(seed):
    waypoints = walk(seed)
    spline, trajectory = interpolate(waypoints), timed(waypoints)
    curve = ScipySpline(spline.knots, spline.waypoints, bc_type="natural")
    fine = np.linspace(0.0, spline.knots[-1], 4000)
    for q in trajectory.evaluate(np.linspace(0.0, trajectory.duration, 100))[0]:
        s = fine[np.argmin(np.linalg.norm(curve(fine) - q, axis=1))]
        for _ in range(3):  # Newton: the nearest point is where the distance stands normal to the curve
            tangent = curve(s, 1)
            s = np.clip(s + (q - curve(s)) @ tangent / (tangent @ tangent), 0.0, spline.knots[-1])
        assert np.linalg.norm(curve(s) - q) < 1e-3


@settings(max_examples=60, deadline=None)
@given(waypoints=ANY_WAYPOINTS)
@example(waypoints=np.array([[0.0, 1.0], [1.0, 0.0], [0.0, 1.0]]))
@example(waypoints=np.array([[0.0], [1.0], [1.0 - 1e-7], [3.0]]))
def test_any_path_is_timed_within_its_limits_from_rest_to_rest(waypoints):
    trajectory = timed(waypoints)
    assert (np.diff(trajectory.times) > 0.0).all()
    assert trajectory.times[0] == 0.0
    assert not trajectory.velocities[[0, -1]].any()
    assert trajectory.stretch >= 1.0
    np.testing.assert_allclose(trajectory.positions[[0, -1]], waypoints[[0, -1]], rtol=0, atol=1e-9)
    assert_within_limits(trajectory)


@settings(max_examples=30, deadline=None)
@given(seed=SEEDS)
def test_some_joint_is_at_a_limit_nearly_all_the_time(seed):
    trajectory = timed(even(seed))
    _, v, a = trajectory.evaluate(np.linspace(0.0, trajectory.duration, 2000)[1:-1])
    load = np.maximum(np.abs(v) / VELOCITIES, np.abs(a) / ACCELERATIONS).max(axis=1)
    assert np.mean(load > 0.9) > 0.9


@settings(max_examples=30, deadline=None)
@given(seed=SEEDS)
def test_passes_through_every_waypoint(seed):
    waypoints = even(seed)
    positions = timed(waypoints).positions
    for waypoint in waypoints:
        assert (positions == waypoint).all(axis=1).any()


@settings(max_examples=30, deadline=None)
@given(seed=SEEDS)
def test_no_joint_is_faster_than_alone(seed):
    waypoints = walk(seed)
    alone = map(analytic_duration, np.abs(waypoints[-1] - waypoints[0]), VELOCITIES, ACCELERATIONS)
    assert timed(waypoints).duration >= max(alone)


@settings(max_examples=20, deadline=None)
@given(seed=SEEDS, factor=st.floats(0.3, 3.0))
def test_velocities_k_times_and_accelerations_k_squared_times_as_large_take_a_kth_of_the_time(seed, factor):
    spline = interpolate(even(seed))
    usual = parameterize(spline, VELOCITIES, ACCELERATIONS)
    faster = parameterize(spline, factor * VELOCITIES, factor**2 * ACCELERATIONS)
    assert faster.duration == pytest.approx(usual.duration / factor, rel=ROUNDING)


@settings(max_examples=20, deadline=None)
@given(seed=SEEDS)
def test_the_way_back_takes_as_long(seed):
    # up to the grid: on it, the greatest acceleration now need not be the best for later where a joint turns back
    for waypoints, tolerance in ((even(seed), 1e-3), (walk(seed), 0.02)):
        assert timed(waypoints[::-1]).duration == pytest.approx(timed(waypoints).duration, rel=tolerance)


def test_stretching_is_hardly_needed():
    stretches = [timed(waypoints(seed)).stretch for waypoints in (walk, even) for seed in range(10)]
    assert max(stretches) < 1.02


def test_is_the_same_every_time():
    first, second = timed(walk(3)), timed(walk(3))
    np.testing.assert_array_equal(first.times, second.times)
    np.testing.assert_array_equal(first.velocities, second.velocities)


def test_a_path_that_goes_nowhere_takes_no_time():
    trajectory = timed(walk(4, 1).repeat(3, axis=0))
    assert trajectory.duration == 0.0
    np.testing.assert_array_equal(trajectory.positions, walk(4, 1))
    assert not trajectory.velocities.any()


def test_repeated_waypoints_change_nothing():
    waypoints = walk(5)
    np.testing.assert_array_equal(timed(waypoints.repeat(2, axis=0)).times, timed(waypoints).times)


def test_a_joint_that_does_not_move_stays():
    waypoints = walk(6)
    waypoints[:, 3] = 0.7
    trajectory = timed(waypoints)
    assert_within_limits(trajectory)
    q, v, a = trajectory.evaluate(np.linspace(0.0, trajectory.duration, 500))
    np.testing.assert_allclose(q[:, 3], 0.7, rtol=1e-15)
    np.testing.assert_allclose(v[:, 3], 0.0, atol=1e-12)
    np.testing.assert_allclose(a[:, 3], 0.0, atol=1e-9)


@pytest.mark.parametrize("size", [1e-2, 1e-4, 1e-6, 1e-8])
@pytest.mark.parametrize("place", [1, 5, 9])
def test_a_tiny_segment_costs_little(size, place):
    waypoints = walk(7)
    with_a_pair = np.insert(waypoints, place, waypoints[place] + size * np.ones(7), axis=0)
    trajectory = timed(with_a_pair)
    assert_within_limits(trajectory)
    assert np.diff(trajectory.times).min() > 5e-5
    assert trajectory.duration < 1.3 * timed(waypoints).duration


def test_there_and_back_takes_twice_the_analytic_time():
    away = walk(8, 2)[1]
    trajectory = timed(np.array([0.0 * away, away, 0.0 * away]))
    assert_within_limits(trajectory)
    one_way = analytic_duration(1.0, (VELOCITIES / np.abs(away)).min(), (ACCELERATIONS / np.abs(away)).min())
    assert 2.0 * one_way * (1 - ROUNDING) <= trajectory.duration <= 2.02 * one_way


def test_five_hundred_waypoints():
    waypoints = even(9, 501)
    trajectory = timed(waypoints)
    assert_within_limits(trajectory, 2)
    assert trajectory.duration == pytest.approx(timed(waypoints[::20]).duration, rel=0.01)


@pytest.mark.parametrize("bad", [0.0, -1.0, np.inf, np.nan])
def test_refuses_a_limit_that_is_none(bad):
    spline = interpolate(walk(1))
    limits = np.where(np.arange(7) == 3, bad, 1.0)
    with pytest.raises(ValueError, match="7 finite and positive velocity limits"):
        parameterize(spline, limits, ACCELERATIONS)
    with pytest.raises(ValueError, match="7 finite and positive acceleration limits"):
        parameterize(spline, VELOCITIES, limits)


def test_refuses_limits_of_another_robot():
    with pytest.raises(ValueError, match="7 finite and positive velocity limits"):
        parameterize(interpolate(walk(1)), VELOCITIES[:6], ACCELERATIONS)
