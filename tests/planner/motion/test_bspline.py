"""A uniform B-spline in time: its ends, its subdivision, its knots, against the basis by de Boor's recursion."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from guidefield.planner.motion.bspline import BSpline, End
from guidefield.planner.motion.trajectory import Trajectory


def de_boor(spline: BSpline, time: float) -> np.ndarray:
    """The curve at a time, by repeated averages (de Boor's algorithm on uniform knots)."""
    i = min(int(time / spline.step), spline.pieces - 1)
    t = time / spline.step - i
    d = [spline.points[i + a] for a in range(4)]
    for r in range(1, 4):
        for a in range(3, r - 1, -1):
            alpha = (t + 3 - a) / (4 - r)
            d[a] = (1.0 - alpha) * d[a - 1] + alpha * d[a]
    return d[3]


def random_spline(seed: int, pieces: int, *, rest: bool = False) -> BSpline:
    rng = np.random.default_rng(seed)
    ends = [End(*(rng.normal(size=(3, 2)) * [[1.0], [not rest], [not rest]])) for _ in range(2)]
    return BSpline.between(ends[0], ends[1], rng.normal(size=(pieces - 3, 2)), float(rng.uniform(0.1, 2.0)))


seeds, pieces = st.integers(0, 10_000), st.integers(4, 20)


@given(seeds, pieces)
def test_its_hermite_knots_are_the_curve(seed: int, count: int) -> None:
    spline = random_spline(seed, count)
    trajectory = Trajectory(*spline.knots())
    times = np.linspace(0.0, spline.duration, 5 * count + 2)
    expected = np.array([de_boor(spline, time) for time in times])
    np.testing.assert_allclose(
        trajectory.evaluate(times)[0], expected, atol=1e-12 * np.abs(spline.points).max() + 1e-12
    )


@given(seeds, pieces)
def test_it_begins_and_ends_as_it_is_told(seed: int, count: int) -> None:
    spline = random_spline(seed, count)
    q, v, a = Trajectory(*spline.knots()).evaluate(np.array([0.0, spline.duration]))
    for k, end in enumerate((spline.start, spline.end)):
        np.testing.assert_array_equal(q[k], end.position)
        np.testing.assert_allclose(v[k], end.velocity, atol=1e-9)
        np.testing.assert_allclose(a[k], end.acceleration, atol=1e-6)


@given(seeds, pieces)
def test_a_subdivided_one_is_the_same_curve(seed: int, count: int) -> None:
    spline = random_spline(seed, count)
    finer = spline.subdivide()
    assert finer.pieces == 2 * spline.pieces
    for time in np.linspace(0.0, spline.duration, 3 * count + 1):
        np.testing.assert_allclose(de_boor(finer, min(time, finer.duration)), de_boor(spline, time), atol=1e-10)


@given(seeds, pieces)
def test_differences_bound_velocities_and_are_accelerations_and_jerks(seed: int, count: int) -> None:
    spline = random_spline(seed, count)
    times = np.linspace(0.0, spline.duration, 50 * count + 1)
    trajectory = Trajectory(*spline.knots())
    _, v, a = trajectory.evaluate(times)
    first, second, third = (np.abs(np.diff(spline.points, n=n, axis=0)) / spline.step**n for n in (1, 2, 3))
    assert (np.abs(v).max(axis=0) <= first.max(axis=0) * (1 + 1e-9) + 1e-9).all()
    np.testing.assert_allclose(np.abs(a).max(axis=0), second.max(axis=0), rtol=1e-6)
    assert abs(trajectory.peak_jerk - third.max()) <= 1e-6 * third.max()


@given(seeds, pieces, st.floats(0.0, 1.0))
def test_towards_another_it_goes_evenly_and_keeps_its_ends(seed: int, count: int, share: float) -> None:
    spline = random_spline(seed, count)
    inner = spline.inner + np.random.default_rng(seed).normal(size=spline.inner.shape)
    other = BSpline.between(spline.start, spline.end, inner, 1.7 * spline.step)
    between = spline.blend(other, share)
    np.testing.assert_allclose(between.inner, (1.0 - share) * spline.inner + share * other.inner, atol=1e-12)
    assert between.step == pytest.approx(1.7**share * spline.step)
    _, positions, velocities = between.knots()
    np.testing.assert_array_equal(positions[[0, -1]], [spline.start.position, spline.end.position])
    np.testing.assert_array_equal(velocities[[0, -1]], [spline.start.velocity, spline.end.velocity])
