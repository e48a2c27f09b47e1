"""Curves in time: Hermite's and B-splines, by oracles and de Boor; joints that come to rest within limits."""

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.planner.motion.bspline import BSpline, End
from guidefield.planner.motion.limit_load import measure_limit_load
from guidefield.planner.motion.trajectory import (
    CLOSE,
    Trajectory,
    choose_jerks,
    concatenate,
    reverse_motion,
    separate_jerks,
    stop_motion,
)
from guidefield.planner.task.motion_limits import KEPT_SHARE
from tests.knots import random_knots

SEEDS = st.integers(0, 2**32 - 1)


@settings(max_examples=12)
@given(seed=SEEDS)
def test_bezier_points_are_the_same_curve(seed):
    trajectory = Trajectory(*random_knots(seed))
    points, t = trajectory.bezier(), 0.37
    bernstein = np.array([(1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t), t**3])
    times = trajectory.times[:-1] + t * np.diff(trajectory.times)
    expected = trajectory.evaluate(times)[0]
    np.testing.assert_allclose(np.einsum("k,mkj->mj", bernstein, points), expected, atol=1e-12)


@pytest.mark.parametrize("rate", [1.0, 7.3, 50.0, 1000.0])
def test_resampling_is_uniform_and_includes_the_end(rate):
    trajectory = Trajectory(*random_knots(9))
    samples = trajectory.resample(rate)
    assert samples.times[0] == 0.0
    assert samples.times[-1] == trajectory.duration
    steps = np.diff(samples.times)
    np.testing.assert_allclose(steps[:-1], 1.0 / rate, rtol=1e-9)
    assert 0.0 < steps[-1] <= 1.0 / rate * (1 + 1e-9)
    for mine, expected in zip(
        (samples.positions, samples.velocities, samples.accelerations), trajectory.evaluate(samples.times), strict=True
    ):
        np.testing.assert_array_equal(mine, expected)


def test_joined_motions_are_each_where_they_were() -> None:
    rng = np.random.default_rng(1)
    first = Trajectory(np.array([0.0, 0.5, 1.0]), rng.normal(size=(3, 2)), rng.normal(size=(3, 2)))
    second = Trajectory(
        np.array([0.0, 2.0]), np.vstack([first.positions[-1:], rng.normal(size=(1, 2))]),
        np.vstack([first.velocities[-1:], rng.normal(size=(1, 2))]),
    )  # fmt: skip
    still = Trajectory(np.zeros(1), first.positions[:1], np.zeros((1, 2)))
    both = concatenate([still, first, second])
    assert both.duration == 3.0
    times = np.linspace(0.0, 1.0, 9)
    np.testing.assert_allclose(both.evaluate(times)[0], first.evaluate(times)[0], atol=1e-12)
    np.testing.assert_allclose(both.evaluate(1.0 + 2.0 * times)[0], second.evaluate(2.0 * times)[0], atol=1e-12)


seeds = st.integers(0, 10_000)


def drawn(seed: int) -> tuple[np.ndarray, ...]:
    """Position, velocity, acceleration, and limits of acceleration and jerk of three joints."""
    rng = np.random.default_rng(seed)
    limits = 10.0 ** rng.uniform(-1, 1, 3)
    moving = rng.random((2, 3)) < 0.8
    velocity, acceleration = rng.normal(size=3) * moving[0], rng.uniform(-1, 1, 3) * limits * moving[1]
    return rng.normal(size=3), velocity, acceleration, limits, limits * 10.0 ** rng.uniform(0, 2, 3)


@given(seeds)
def test_it_begins_in_its_state_ends_at_rest_and_keeps_limits(seed: int) -> None:
    position, velocity, acceleration, limits, jerks = drawn(seed)
    motion = stop_motion(position, velocity, acceleration, limits, jerks)
    np.testing.assert_array_equal(motion.positions[0], position)
    np.testing.assert_array_equal(motion.velocities[0], velocity)
    if motion.duration == 0.0:
        assert not velocity.any()
        assert not acceleration.any()
        return
    times = np.linspace(0.0, motion.duration, 20_001)
    q, v, a = motion.evaluate(times)
    scale = np.abs(velocity).max() + limits.max()
    np.testing.assert_allclose(a[0], acceleration, atol=1e-6 * scale)
    np.testing.assert_allclose(v[-1], 0.0, atol=1e-9 * scale)
    np.testing.assert_allclose(a[-1], 0.0, atol=1e-5 * scale)
    assert (np.abs(a) <= limits * (1 + 1e-6) + 1e-7 * scale).all()
    step = times[1]
    assert (np.abs(np.diff(a, axis=0)) / step <= jerks * (1 + 1e-3) + 1e-6 * scale / step).all()
    integrated = position + step * (np.cumsum(v, axis=0)[-1] - 0.5 * (v[0] + v[-1]))
    np.testing.assert_allclose(q[-1], integrated, atol=1e-4 * scale * motion.duration)


@given(st.floats(1e-3, 10.0), st.floats(0.1, 20.0), st.floats(1.0, 1e3))
def test_without_acceleration_it_takes_the_time_of_the_formula(speed: float, limit: float, jerk: float) -> None:
    zero = np.zeros(1)
    motion = stop_motion(zero, np.array([-speed]), zero, np.array([limit]), np.array([jerk]))
    ramps = limit**2 / jerk
    expected = speed / limit + limit / jerk if speed > ramps else 2.0 * math.sqrt(speed / jerk)
    assert motion.duration == pytest.approx(expected, rel=1e-9)
    assert motion.positions[-1, 0] == pytest.approx(-0.5 * speed * expected, rel=1e-6), "as it is symmetric in time"


@given(seeds)
def test_backwards_is_the_same_way_from_rest(seed: int) -> None:
    motion = stop_motion(*drawn(seed))
    back = reverse_motion(motion)
    times = np.linspace(0.0, motion.duration, 50)
    q, v, _ = motion.evaluate(times)
    p, w, _ = back.evaluate(motion.duration - times)
    np.testing.assert_allclose(p, q, atol=1e-9 * (1.0 + np.abs(q).max()))
    np.testing.assert_allclose(w, -v, atol=1e-9 * (1.0 + np.abs(v).max()))


@given(seeds)
def test_knots_are_apart_for_jerks_that_are_hardly_lower(seed: int) -> None:
    _, velocity, acceleration, limits, jerks = drawn(seed)
    lower = separate_jerks(velocity, acceleration, limits, jerks, np.zeros(3))
    assert (lower <= jerks).all()
    assert (lower >= 0.88 * jerks).all()
    again = separate_jerks(velocity, acceleration, limits, lower, np.zeros(3))
    if (np.diff(stop_motion(np.zeros(3), velocity, acceleration, limits, lower).times) >= CLOSE).all():
        np.testing.assert_array_equal(again, lower)


def test_two_joints_that_stop_almost_together_are_set_apart() -> None:
    velocity, zero, limits = np.array([1.0, 1.0001]), np.zeros(2), np.array([50.0, 50.0])
    jerks = np.array([120.0, 120.0])
    assert np.diff(stop_motion(zero, velocity, zero, limits, jerks).times).min() < 1e-4
    lower = separate_jerks(velocity, zero, limits, jerks, zero)
    assert lower[0] == 120.0
    assert np.diff(stop_motion(zero, velocity, zero, limits, lower).times).min() >= CLOSE
    np.testing.assert_array_equal(
        separate_jerks(velocity, zero, limits, jerks, jerks), jerks, err_msg="none may be lower"
    )


@pytest.mark.parametrize("jerk", [500.0, 7500.0])  # of the benchmarks, and of a Panda
def test_seven_joints_stop_within_their_limits_of_jerk(jerk: float) -> None:
    fast, rise = np.array([2.175] * 4 + [2.61] * 3), np.array([15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0])
    rng, limits, none, loads = np.random.default_rng(0), np.full(7, jerk), np.zeros(7), []
    for _ in range(200):
        velocity, acceleration = rng.uniform(-0.5, 0.5, 7) * fast, rng.uniform(-0.5, 0.5, 7) * rise
        jerks = separate_jerks(velocity, acceleration, rise, choose_jerks(rise, limits, none), none)
        motion = stop_motion(rng.uniform(-2.0, 2.0, 7), velocity, acceleration, rise, jerks)
        load = measure_limit_load(motion.times, motion.positions, motion.velocities, 2.0 * fast, rise, limits)
        loads.append(load**3)
    assert max(loads) <= 1.0 + 1e-3
    assert sum(load > KEPT_SHARE for load in loads) <= 1, "rounding is more where knots can't be set apart"


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


starts, pieces = st.integers(0, 10_000), st.integers(4, 20)


@given(starts, pieces)
def test_its_hermite_knots_are_the_curve(seed: int, count: int) -> None:
    spline = random_spline(seed, count)
    trajectory = Trajectory(*spline.knots())
    times = np.linspace(0.0, spline.duration, 5 * count + 2)
    expected = np.array([de_boor(spline, time) for time in times])
    np.testing.assert_allclose(
        trajectory.evaluate(times)[0], expected, atol=1e-12 * np.abs(spline.points).max() + 1e-12
    )


@given(starts, pieces)
def test_it_begins_and_ends_as_it_is_told(seed: int, count: int) -> None:
    spline = random_spline(seed, count)
    q, v, a = Trajectory(*spline.knots()).evaluate(np.array([0.0, spline.duration]))
    for k, end in enumerate((spline.start, spline.end)):
        np.testing.assert_array_equal(q[k], end.position)
        np.testing.assert_allclose(v[k], end.velocity, atol=1e-9)
        np.testing.assert_allclose(a[k], end.acceleration, atol=1e-6)


@given(starts, pieces)
def test_a_subdivided_one_is_the_same_curve(seed: int, count: int) -> None:
    spline = random_spline(seed, count)
    finer = spline.subdivide()
    assert finer.pieces == 2 * spline.pieces
    for time in np.linspace(0.0, spline.duration, 3 * count + 1):
        np.testing.assert_allclose(de_boor(finer, min(time, finer.duration)), de_boor(spline, time), atol=1e-10)


@given(starts, pieces)
def test_differences_bound_velocities_and_are_accelerations_and_jerks(seed: int, count: int) -> None:
    spline = random_spline(seed, count)
    times = np.linspace(0.0, spline.duration, 50 * count + 1)
    trajectory = Trajectory(*spline.knots())
    _, v, a = trajectory.evaluate(times)
    first, second, third = (np.abs(np.diff(spline.points, n=n, axis=0)) / spline.step**n for n in (1, 2, 3))
    assert (np.abs(v).max(axis=0) <= first.max(axis=0) * (1 + 1e-9) + 1e-9).all()
    np.testing.assert_allclose(np.abs(a).max(axis=0), second.max(axis=0), rtol=1e-6)
    assert abs(trajectory.peak_jerk - third.max()) <= 1e-6 * third.max()


@given(starts, pieces, st.floats(0.0, 1.0))
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
