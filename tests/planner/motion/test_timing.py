"""Timing against toppra and closed forms, limits against dense samples, the curve along a path against scipy's."""

import itertools

import numpy as np
import pytest
import scipy.interpolate
import toppra
from hypothesis import example, given, settings, strategies as st
from hypothesis.extra import numpy as arrays

from guidefield.planner.motion.timing import (
    PIECES,
    SHORTEST_PIECE,
    Limits,
    PathCurve,
    find_fastest_progress,
    length_of,
    parameterize,
    remove_repetitions,
    stretch_spline_to_limits,
    subdivide,
)
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.path_so_far import CURVE_SPACING

# Those of a Panda, accelerations halved.
VELOCITIES = np.array([2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61])
ACCELERATIONS = np.array([7.5, 3.75, 5.0, 6.25, 7.5, 10.0, 10.0])


def walk(seed: int, n: int = 10) -> np.ndarray:
    """Waypoints with a corner at each."""
    return np.cumsum(np.random.default_rng(seed).normal(size=(n, 7)) * 0.3, axis=0)


def even(seed: int, n: int = 32) -> np.ndarray:
    """Evenly spaced waypoints on a curve that bends slowly."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, 1.0, n)[:, None]
    return rng.normal(size=7) + t * rng.normal(size=7) + np.sin(np.pi * t) * rng.normal(size=7) * 0.3


def curve_along(path: np.ndarray, finer: int = 1) -> PathCurve:
    return PathCurve.along(subdivide(remove_repetitions(path), CURVE_SPACING / finer))


def soonest(
    path: np.ndarray,
    velocities: np.ndarray | None = None,
    accelerations: np.ndarray | None = None,
    jerks: np.ndarray | None = None,
    finer: int = 1,
) -> Trajectory:
    """The fastest motion along a path; those limits that are not given are a Panda's, without any of jerk."""
    nv = path.shape[1]
    limits = Limits(
        VELOCITIES[:nv] if velocities is None else velocities,
        ACCELERATIONS[:nv] if accelerations is None else accelerations,
        np.full(nv, np.inf) if jerks is None else jerks,
    )
    return stretch_spline_to_limits(parameterize(curve_along(path, finer), limits, finer), limits)


SEEDS = st.integers(0, 2**32 - 1)
ANY_WAYPOINTS = arrays.arrays(
    float, st.tuples(st.integers(2, 9), st.integers(1, 4)), elements=st.floats(-4.0, 4.0, width=32)
)


def dense(curve: PathCurve, count: int = 400) -> np.ndarray:
    return curve.at(np.linspace(0.0, curve.pieces, count))


def distances_to_polyline(points: np.ndarray, path: np.ndarray) -> np.ndarray:
    nearest = np.full(len(points), np.inf)
    for a, b in itertools.pairwise(path):
        t = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        nearest = np.minimum(nearest, np.linalg.norm(points - a - t[:, None] * (b - a), axis=1))
    return nearest


@settings(max_examples=18)
@given(seed=SEEDS, steps=st.integers(1, 5))
def test_it_is_scipys_spline_of_its_control_points(seed: int, steps: int) -> None:
    curve = curve_along(walk(seed, 5))
    other = scipy.interpolate.BSpline(np.arange(-3.0, curve.pieces + 4.0), curve.points, 3)
    at = np.arange(curve.pieces * steps + 1) / steps
    np.testing.assert_allclose(curve.at(at), other(at), atol=1e-12)
    for order, derivatives in enumerate(curve.derivatives(steps), 1):
        np.testing.assert_allclose(derivatives, other(at, order), atol=1e-12)


@settings(max_examples=18)
@given(waypoints=ANY_WAYPOINTS)
def test_it_keeps_the_ends_and_the_range_of_its_path(waypoints: np.ndarray) -> None:
    path = remove_repetitions(waypoints)
    if len(path) == 1:
        return
    curve = curve_along(path)
    points = dense(curve)
    np.testing.assert_allclose(points[[0, -1]], path[[0, -1]], atol=1e-12)
    assert (points >= path.min(axis=0) - 1e-12).all()
    assert (points <= path.max(axis=0) + 1e-12).all()
    second = curve.derivatives(1)[1]
    np.testing.assert_allclose(second[[0, -1]], 0.0, atol=1e-12)


@settings(max_examples=18)
@given(seed=SEEDS)
def test_twice_as_many_control_points_are_at_half_the_distance_from_the_path(seed: int) -> None:
    path = walk(seed, 6)
    farthest = []
    for finer in (1, 2, 4, 8, 16):
        places = subdivide(path, CURVE_SPACING / finer)
        farthest.append(distances_to_polyline(dense(curve_along(path, finer), 4000), path).max())
        assert farthest[-1] <= np.linalg.norm(np.diff(places, 2, axis=0), axis=1).max() / 6.0 + 1e-12
    assert farthest[4] < 0.15 * farthest[0]


@settings(max_examples=18)
@given(waypoints=ANY_WAYPOINTS, spacing=st.floats(0.05, 3.0))
def test_places_along_a_path_are_on_it_and_close(waypoints: np.ndarray, spacing: float) -> None:
    path = remove_repetitions(waypoints)
    if len(path) == 1:
        return
    places = subdivide(path, spacing)
    assert len(places) >= 3
    assert np.linalg.norm(np.diff(places, axis=0), axis=1).max() <= spacing * (1.0 + 1e-12)
    assert distances_to_polyline(places, path).max() <= 1e-12
    assert length_of(places) == pytest.approx(length_of(path))
    assert all((places == waypoint).all(axis=1).any() for waypoint in path)


def test_a_path_that_goes_nowhere_is_a_point_and_there_and_back_is_none() -> None:
    a, b = walk(4, 2)
    np.testing.assert_array_equal(remove_repetitions(np.array([a, a, a])), [a])
    np.testing.assert_array_equal(remove_repetitions(a[None]), [a])
    assert len(remove_repetitions(np.array([a, b, a]))) == 3


SEEDS = st.integers(0, 2**32 - 1)
# What rounding may add when a motion is evaluated between its knots.
ROUNDING = 1e-9  # a motion takes this times the optimal time: it begins and ends without acceleration
UNLIMITED = np.full(7, np.inf)


def analytic_duration(distance, velocity, acceleration):
    """From rest to rest over a distance: bang-bang, or with a segment at full speed."""
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


@settings(max_examples=12)
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


@settings(max_examples=12)
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


@settings(max_examples=18)
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


@settings(max_examples=18)
@given(seed=SEEDS)
def test_some_joint_is_at_a_limit_nearly_all_the_time(seed):
    trajectory = soonest(even(seed))
    _, v, a = trajectory.evaluate(np.linspace(0.0, trajectory.duration, 2000)[1:-1])
    load = np.maximum(np.abs(v) / VELOCITIES, np.abs(a) / ACCELERATIONS).max(axis=1)
    assert np.mean(load > 0.9) > 0.8


@settings(max_examples=12)
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
