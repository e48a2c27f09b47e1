"""The curve along a path against scipy's B-spline; how far it is off the path; the places along one."""

import itertools

import numpy as np
import pytest
import scipy.interpolate
from hypothesis import given, settings, strategies as st
from hypothesis.extra import numpy as arrays

from guidefield.planner.motion.timing import PathCurve, length_of, remove_repetitions, subdivide
from guidefield.planner.path_so_far import CURVE_SPACING
from tests.planner.motion.paths import curve_along, walk

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


@settings(max_examples=18, deadline=None)
@given(seed=SEEDS, steps=st.integers(1, 5))
def test_it_is_scipys_spline_of_its_control_points(seed: int, steps: int) -> None:
    curve = curve_along(walk(seed, 5))
    other = scipy.interpolate.BSpline(np.arange(-3.0, curve.pieces + 4.0), curve.points, 3)
    at = np.arange(curve.pieces * steps + 1) / steps
    np.testing.assert_allclose(curve.at(at), other(at), atol=1e-12)
    for order, derivatives in enumerate(curve.derivatives(steps), 1):
        np.testing.assert_allclose(derivatives, other(at, order), atol=1e-12)


@settings(max_examples=18, deadline=None)
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


@settings(max_examples=18, deadline=None)
@given(seed=SEEDS)
def test_twice_as_many_control_points_are_at_half_the_distance_from_the_path(seed: int) -> None:
    path = walk(seed, 6)
    farthest = []
    for finer in (1, 2, 4, 8, 16):
        places = subdivide(path, CURVE_SPACING / finer)
        farthest.append(distances_to_polyline(dense(curve_along(path, finer), 4000), path).max())
        assert farthest[-1] <= np.linalg.norm(np.diff(places, 2, axis=0), axis=1).max() / 6.0 + 1e-12
    assert farthest[4] < 0.15 * farthest[0]


@settings(max_examples=18, deadline=None)
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
