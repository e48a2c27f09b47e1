"""The natural cubic spline against scipy's, its Bézier points, and why its knots are spaced as they are."""

import itertools

import numpy as np
import pytest
import scipy.interpolate
from hypothesis import given, settings, strategies as st
from hypothesis.extra import numpy as arrays

from guidefield.planner.motion.settings import SPLINE
from guidefield.planner.motion.spline import interpolate

SEEDS = st.integers(0, 2**32 - 1)
ANY_WAYPOINTS = arrays.arrays(
    float, st.tuples(st.integers(2, 9), st.integers(1, 4)), elements=st.floats(-4.0, 4.0, width=32)
)


def random_waypoints(seed, n=None, nv=7):
    rng = np.random.default_rng(seed)
    return np.cumsum(rng.normal(size=(n or rng.integers(2, 40), nv)) * 0.3, axis=0)


def scipys(spline):
    return scipy.interpolate.CubicSpline(spline.knots, spline.waypoints, bc_type="natural")


@settings(max_examples=40, deadline=None)
@given(seed=SEEDS)
def test_agrees_with_scipy(seed):
    spline = interpolate(random_waypoints(seed))
    s = np.linspace(0.0, spline.knots[-1], 200)
    for derivative, mine in enumerate(spline.evaluate(s)):
        expected = scipys(spline)(s, derivative)
        np.testing.assert_allclose(mine, expected, rtol=0, atol=1e-11 * max(1.0, np.abs(expected).max()))


@settings(max_examples=40, deadline=None)
@given(seed=SEEDS)
def test_passes_through_every_waypoint_exactly(seed):
    waypoints = random_waypoints(seed)
    spline = interpolate(waypoints)
    np.testing.assert_array_equal(spline.evaluate(spline.knots)[0], waypoints)


@settings(max_examples=60, deadline=None)
@given(waypoints=ANY_WAYPOINTS)
def test_is_twice_continuously_differentiable_and_straight_at_its_ends(waypoints):
    spline = interpolate(waypoints)
    h = np.diff(spline.knots)[:, None]
    c = spline.coefficients
    ends = (
        c[:, 0] + h * (c[:, 1] + h * (c[:, 2] + h * c[:, 3])),
        c[:, 1] + h * (2.0 * c[:, 2] + 3.0 * h * c[:, 3]),
        2.0 * c[:, 2] + 6.0 * h * c[:, 3],
    )
    starts = (c[:, 0], c[:, 1], 2.0 * c[:, 2])
    for start, end in zip(starts, ends, strict=True):
        np.testing.assert_allclose(end[:-1], start[1:], rtol=0, atol=1e-9 * max(1.0, np.abs(start).max()))
    size = max(1.0, np.abs(starts[2]).max())
    np.testing.assert_allclose(starts[2][0], 0.0, atol=1e-12)
    np.testing.assert_allclose(ends[2][-1], 0.0, atol=1e-9 * size)


@settings(max_examples=60, deadline=None)
@given(waypoints=ANY_WAYPOINTS)
def test_bezier_points_are_the_same_curve(waypoints):
    spline = interpolate(waypoints)
    points = spline.bezier()
    assert points.shape == (len(spline.knots) - 1, 4, waypoints.shape[1])
    np.testing.assert_array_equal(points[1:, 0], points[:-1, 3])
    for t in (0.0, 0.3, 0.5, 0.9, 1.0):
        bernstein = np.array([(1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t), t**3])
        s = np.minimum(spline.knots[:-1] + t * np.diff(spline.knots), spline.knots[1:])
        expected = spline.evaluate(s)[0]
        np.testing.assert_allclose(np.einsum("k,mkj->mj", bernstein, points), expected, rtol=0, atol=1e-10)


@settings(max_examples=30, deadline=None)
@given(seed=SEEDS)
def test_the_way_back_is_the_same_curve(seed):
    waypoints = random_waypoints(seed)
    there, back = interpolate(waypoints), interpolate(waypoints[::-1])
    s = np.linspace(0.0, there.knots[-1], 50)
    np.testing.assert_allclose(
        back.evaluate(np.clip(back.knots[-1] - s, 0.0, back.knots[-1]))[0], there.evaluate(s)[0], atol=1e-10
    )


def distance_to_polyline(points, waypoints):
    """Largest distance of the points to the polyline."""
    nearest = np.full(len(points), np.inf)
    for a, b in itertools.pairwise(waypoints):
        t = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        nearest = np.minimum(nearest, np.linalg.norm(points - a - t[:, None] * (b - a), axis=1))
    return nearest.max()


def test_swings_away_from_the_polyline_less_than_with_knots_spaced_by_the_chords():
    ratios = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        directions = rng.normal(size=(11, 7))
        chords = directions / np.linalg.norm(directions, axis=1)[:, None] * 10.0 ** rng.uniform(-1.5, 0.0, (11, 1))
        waypoints = np.concatenate([np.zeros((1, 7)), np.cumsum(chords, axis=0)])
        by_chords = np.concatenate([[0.0], np.cumsum(np.linalg.norm(chords, axis=1))])
        other = scipy.interpolate.CubicSpline(by_chords, waypoints, bc_type="natural")
        mine = interpolate(waypoints)
        swing = distance_to_polyline(mine.evaluate(np.linspace(0.0, mine.knots[-1], 1000))[0], waypoints)
        ratios.append(swing / distance_to_polyline(other(np.linspace(0.0, by_chords[-1], 1000)), waypoints))
    assert np.median(ratios) < 0.6
    assert max(ratios) < 1.0


def test_repeated_waypoints_are_left_out():
    a, b, c = random_waypoints(1, 3)
    spline = interpolate(np.array([a, a, b, b + SPLINE.repeated / 10, b, c, c]))
    np.testing.assert_array_equal(spline.waypoints, [a, b, c])


def test_the_goal_is_kept_rather_than_what_it_repeats():
    a, b = random_waypoints(2, 2)
    goal = b + SPLINE.repeated / 10
    np.testing.assert_array_equal(interpolate(np.array([a, b, goal])).waypoints, [a, goal])


def test_a_waypoint_between_two_that_repeat_each_other_is_no_trap():
    a = random_waypoints(3, 2)[0]
    step = np.eye(7)[0] * SPLINE.repeated
    assert interpolate(np.array([a, a + 1.2 * step, a + 0.6 * step])).is_point


def test_a_path_that_goes_nowhere_is_a_point():
    a = random_waypoints(4, 2)[0]
    spline = interpolate(np.array([a, a, a]))
    assert spline.is_point
    q, first, second = spline.evaluate(np.linspace(0.0, spline.knots[-1], 5))
    np.testing.assert_array_equal(q, np.tile(a, (5, 1)))
    assert not first.any()
    assert not second.any()
    np.testing.assert_array_equal(spline.bezier(), np.tile(a, (1, 4, 1)))


def test_there_and_back_is_not_a_point():
    a, b = random_waypoints(5, 2)
    assert not interpolate(np.array([a, b, a])).is_point


def test_arrays_are_read_only_and_the_callers_are_not():
    waypoints = random_waypoints(6)
    spline = interpolate(waypoints)
    waypoints[:] = 0.0
    assert spline.waypoints.any()
    for array in (spline.knots, spline.waypoints, spline.coefficients):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0.0


@pytest.mark.parametrize("waypoints", [np.zeros((1, 3)), np.zeros(3), np.zeros((0, 3)), np.zeros((2, 2, 2))])
def test_refuses_what_is_no_list_of_waypoints(waypoints):
    with pytest.raises(ValueError, match="at least two waypoints"):
        interpolate(waypoints)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_refuses_waypoints_that_are_not_finite(value):
    with pytest.raises(ValueError, match="finite"):
        interpolate(np.array([[0.0, 1.0], [value, 1.0]]))


@pytest.mark.parametrize("s", [-1e-9, 100.0, np.nan])
def test_refuses_to_extrapolate(s):
    with pytest.raises(ValueError, match="curve runs from"):
        interpolate(np.eye(3)).evaluate(np.array([0.5, s]))
