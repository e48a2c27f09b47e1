"""Time-optimal timing against toppra and against closed forms; the limits against dense samples."""

import numpy as np
import pytest
import toppra
from hypothesis import example, given, settings, strategies as st

from guidefield.planner.motion.timing import PIECES, SHORTEST_PIECE, Limits, find_fastest_progress, parameterize
from tests.planner.motion.paths import ACCELERATIONS, VELOCITIES, curve_along, even, soonest, walk
from tests.planner.motion.test_path_curve import ANY_WAYPOINTS

SEEDS = st.integers(0, 2**32 - 1)
# What rounding may add when a motion is evaluated between its knots.
ROUNDING = 1e-9
"""A motion takes this times the optimal time: it begins and ends without acceleration."""
UNLIMITED = np.full(7, np.inf)


def analytic_duration(distance, velocity, acceleration):
    """From rest to rest over a distance: bang-bang, or with a stretch at full speed."""
    if distance <= velocity**2 / acceleration:
        return 2.0 * np.sqrt(distance / acceleration)
    return distance / velocity + velocity / acceleration


def toppras_duration(waypoints, steps_a_piece):
    """Along the same curve, by places on it that are close together."""
    curve = curve_along(waypoints)
    places = np.linspace(0.0, curve.pieces, 16 * curve.pieces + 1)
    path = toppra.SplineInterpolator(places, curve.at(places), bc_type="natural")
    limits = [
        toppra.constraint.JointVelocityConstraint(np.stack([-VELOCITIES, VELOCITIES], axis=1)),
        toppra.constraint.JointAccelerationConstraint(
            np.stack([-ACCELERATIONS, ACCELERATIONS], axis=1),
            discretization_scheme=toppra.constraint.DiscretizationType.Interpolation,
        ),
    ]
    grid = np.linspace(0.0, curve.pieces, steps_a_piece * curve.pieces + 1)
    plan = toppra.algorithm.TOPPRA(limits, path, gridpoints=grid, parametrizer="ParametrizeConstAccel")
    return plan.compute_trajectory(0, 0).duration


def assert_within_limits(trajectory, jerk=None, samples_a_piece=10):
    nv = trajectory.positions.shape[1]
    times = np.unique(np.linspace(trajectory.times[:-1], trajectory.times[1:], samples_a_piece + 1))
    _, v, a = trajectory.evaluate(times)
    assert (np.abs(v) <= VELOCITIES[:nv] * (1 + ROUNDING)).all()
    assert (np.abs(a) <= ACCELERATIONS[:nv] * (1 + ROUNDING)).all()
    if jerk is not None:
        # accelerations are continuous: what they change by between two moments is what jerk allows
        changes = np.abs(np.diff(a, axis=0)) / np.diff(times)[:, None]
        assert (changes <= jerk * (1 + 1e-5) + 1e-6).all()


@pytest.mark.parametrize("paths", [walk, even])
@pytest.mark.parametrize("seed", range(3))
def test_the_speed_is_as_toppras(paths, seed):
    waypoints = paths(seed)
    optimal = find_fastest_progress(curve_along(waypoints), Limits(VELOCITIES, ACCELERATIONS, UNLIMITED))
    assert 0.998 < optimal.duration / toppras_duration(waypoints, 16) < 1.025


@settings(max_examples=12, deadline=None)
@given(seed=SEEDS)
def test_the_motion_takes_little_longer_than_the_optimal_speed(seed):
    for waypoints, most in ((walk(seed), 1.12), (even(seed), 1.04)):
        optimal = find_fastest_progress(curve_along(waypoints), Limits(VELOCITIES, ACCELERATIONS, UNLIMITED))
        assert soonest(waypoints).duration < most * optimal.duration


@pytest.mark.parametrize("distance", [1e-6, 1e-3, 0.05, 0.3, 1.0, 5.0])
@pytest.mark.parametrize("pieces", [1, 3, 20])
def test_a_straight_motion_takes_the_analytic_time(distance, pieces):
    waypoints = np.zeros((pieces + 1, 7))
    waypoints[:, 2] = np.linspace(0.5, 0.5 + distance, pieces + 1)
    expected = analytic_duration(distance, VELOCITIES[2], ACCELERATIONS[2])
    few = max(PIECES[0], min(PIECES[-1], int(expected / SHORTEST_PIECE)))
    duration = soonest(waypoints).duration
    assert expected * (1 - ROUNDING) <= duration <= 1.01 * expected * few / (few - 2)


@settings(max_examples=12, deadline=None)
@given(seed=SEEDS)
def test_twice_as_many_pieces_are_closer_to_the_curve(seed):
    curve = curve_along(walk(seed))
    limits = Limits(VELOCITIES, ACCELERATIONS, UNLIMITED)
    fine = curve.at(np.linspace(0.0, curve.pieces, 8000))
    away = []
    for finer in (1, 4):
        spline = parameterize(curve, limits, finer)
        at = spline.at(np.linspace(0.0, spline.pieces, 100))
        away.append(max(np.linalg.norm(fine - q, axis=1).min() for q in at))
    assert away[0] < 0.02
    assert away[1] < max(0.2 * away[0], 1e-3)


@settings(max_examples=18, deadline=None)
@given(waypoints=ANY_WAYPOINTS, jerk=st.one_of(st.none(), st.floats(1.0, 1e4)), finer=st.sampled_from([1, 2, 8]))
@example(waypoints=np.array([[0.0, 1.0], [1.0, 0.0], [0.0, 1.0]]), jerk=None, finer=1)
@example(waypoints=np.array([[0.0], [1.0], [1.0 - 1e-7], [3.0]]), jerk=None, finer=1)
def test_any_path_is_timed_within_its_limits_from_rest_to_rest(waypoints, jerk, finer):
    if not np.ptp(waypoints, axis=0).max() > 1e-8:
        return
    nv = waypoints.shape[1]
    trajectory = soonest(waypoints, jerks=None if jerk is None else np.full(nv, jerk), finer=finer)
    assert (np.diff(trajectory.times) > 0.0).all()
    assert trajectory.times[0] == 0.0
    assert not trajectory.velocities[[0, -1]].any()
    np.testing.assert_array_equal(trajectory.positions[[0, -1]], waypoints[[0, -1]])
    pieces = trajectory.bezier()
    assert (pieces >= waypoints.min(axis=0) - 1e-12).all()
    assert (pieces <= waypoints.max(axis=0) + 1e-12).all()
    assert_within_limits(trajectory, jerk)


@settings(max_examples=18, deadline=None)
@given(seed=SEEDS)
def test_some_joint_is_at_a_limit_nearly_all_the_time(seed):
    trajectory = soonest(even(seed))
    _, v, a = trajectory.evaluate(np.linspace(0.0, trajectory.duration, 2000)[1:-1])
    load = np.maximum(np.abs(v) / VELOCITIES, np.abs(a) / ACCELERATIONS).max(axis=1)
    assert np.mean(load > 0.9) > 0.8


@settings(max_examples=12, deadline=None)
@given(seed=SEEDS)
def test_the_way_back_takes_as_long(seed):
    # up to the grid: on it, the greatest acceleration now need not be the best for later where a joint turns back
    for waypoints, tolerance in ((even(seed), 0.01), (walk(seed), 0.08)):
        assert soonest(waypoints[::-1]).duration == pytest.approx(soonest(waypoints).duration, rel=tolerance)


@pytest.mark.parametrize("size", [1e-2, 1e-4, 1e-6, 1e-8])
@pytest.mark.parametrize("place", [1, 5, 9])
def test_a_tiny_segment_costs_little(size, place):
    waypoints = walk(7)
    with_a_pair = np.insert(waypoints, place, waypoints[place] + size * np.ones(7), axis=0)
    trajectory = soonest(with_a_pair)
    assert_within_limits(trajectory)
    assert trajectory.duration < 1.3 * soonest(waypoints).duration


@pytest.mark.parametrize("jerk", [20.0, 200.0, 5000.0])
def test_a_limit_of_jerk_is_kept_by_scaling_time(jerk):
    for waypoints in (walk(1), even(1)):
        motion = soonest(waypoints, jerks=np.full(7, jerk))
        assert_within_limits(motion, jerk)
        np.testing.assert_allclose(motion.accelerations[[0, -1]], 0.0, atol=1e-7)
        assert motion.duration > 0.8 * soonest(waypoints).duration


@pytest.mark.parametrize("bad", [0.0, -1.0, np.inf, np.nan])
def test_refuses_a_limit_that_is_none(bad):
    curve, limits = curve_along(walk(1)), np.where(np.arange(7) == 3, bad, 1.0)
    with pytest.raises(ValueError, match="7 finite and positive velocity limits"):
        parameterize(curve, Limits(limits, ACCELERATIONS, UNLIMITED))
    with pytest.raises(ValueError, match="7 finite and positive acceleration limits"):
        parameterize(curve, Limits(VELOCITIES, limits, UNLIMITED))
    if not np.isinf(bad):
        with pytest.raises(ValueError, match="7 positive jerk limits"):
            parameterize(curve, Limits(VELOCITIES, ACCELERATIONS, limits))
