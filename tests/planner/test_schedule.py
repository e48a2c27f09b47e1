"""Slices of time against Coal at dense times, until when a place is free, and limits that motions in time keep."""

import dataclasses
from typing import Any

import numpy as np
import pytest
import scipy.interpolate
from hypothesis import given, settings, strategies as st

from guidefield.collision.clearance import clearance_at, contacts_at
from guidefield.collision.world import World
from guidefield.messages import scene as messages
from guidefield.messages.values import Placement
from guidefield.planner.motion.trajectory import Trajectory, piece_accelerations
from guidefield.planner.schedule import bezier, bound_slopes, clamp_smoothly, find_leaving
from guidefield.planner.slices import SCHEDULE, Slices, find_free_from, find_meeting
from guidefield.planner.task.problem import Problem
from guidefield.prove.curve import excesses
from tests.planner.problems import closed_shell, problem, scene_of
from tests.robots import group, rest

PANDA = group("panda")
START = PANDA.chart(rest(PANDA))


def moved(*by: float) -> np.ndarray:
    """A chart point away from the start."""
    return START + np.array(by)


def flight(times: list[float], *places: tuple[float, float, float]) -> messages.ObstacleTrajectory:
    return messages.ObstacleTrajectory(times=times, placements=[Placement(position=place) for place in places])


def ball(radius: float = 0.1, **fields: Any) -> messages.Sphere:
    return messages.Sphere(name="ball", radius=radius, **fields)


PASSING = flight([0.5, 2.5], (0.35, -1.2, 0.6), (0.35, 1.2, 0.6))


def asked(*obstacles: messages.Obstacle, **options: Any) -> Problem:
    return problem(PANDA, scene_of(*obstacles), planes=(), **options)


# ---- slices


@pytest.mark.parametrize("kind", ["ball", "shell", "shell as a box"])
def test_what_a_slice_says_is_free_is_free_at_all_times_in_it(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if kind == "shell as a box":
        coarse = dataclasses.replace(SCHEDULE, most_triangles=1)
        monkeypatch.setattr("guidefield.planner.slices.SCHEDULE", coarse)
    shell = closed_shell(0.15)
    mover = ball(trajectory=PASSING) if kind == "ball" else messages.Mesh(
        name="shell", vertices=shell.vertices, triangles=shell.triangles, trajectory=PASSING
    )  # fmt: skip
    made = asked(mover, min_clearance=0.01)
    slices = Slices(made, 0.05)
    zs = START + np.random.default_rng(3).uniform(-0.6, 0.6, (12, 7))
    free = 0
    for index, together in [*((index, 1) for index in range(15, 50, 12)), (4, 4), (9, 4)]:
        touching, length = slices.touching(index, zs, together), together * 0.05
        for time in index * length + np.linspace(0.0, length, 1 + 2 * together):
            world = World.build(PANDA, made.scene.at(time))
            for z in zs[~touching]:
                assert clearance_at(world, PANDA.expand_from_chart(z)).obstacle_distance >= 0.01
        free += int((~touching).sum())
        middle = made.at((index + 0.5) * length).world
        nearest = np.array([clearance_at(middle, PANDA.expand_from_chart(z)).obstacle_distance for z in zs])
        assert not touching[nearest > 0.1 * together].any(), "what is far is free"
    assert 0 < free < 5 * len(zs)


# ---- standing


def test_until_when_and_from_when_on_a_place_is_free_is_what_dense_times_say() -> None:
    made = asked(ball(trajectory=flight([0.5, 2.5], (0.35, -1.2, 0.6), (0.35, 1.2, 0.6))))
    times = np.arange(1.0, 2.2, 0.01)
    touching = [bool(contacts_at(World.build(PANDA, made.scene.at(t)), PANDA.expand_from_chart(START))) for t in times]
    first, last = times[touching][0], times[touching][-1]
    until, refusal = find_meeting(made, START)
    assert first - 0.04 <= until <= first
    assert refusal.pair[1] == "ball"
    assert last <= find_free_from(made, START) <= last + 0.04
    away = moved(2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert find_meeting(asked(ball(trajectory=flight([0.0, 1.0], (2.0, 0.0, 0.5), (2.0, 1.0, 0.5)))), away) == (
        np.inf,
        None,
    )


# ---- schedules


def require_within(made: Problem, motion: Trajectory) -> None:
    """Dense samples keep all limits; where jerk has one, accelerations don't jump at knots."""
    _, v, a = motion.evaluate(np.linspace(0.0, motion.times[-1], 20_001))
    assert (np.abs(v) <= made.group.velocity_limits * (1.0 + 1e-9)).all()
    assert (np.abs(a) <= made.group.acceleration_limits * (1.0 + 1e-9)).all()
    if made.jerk_limits is not None:
        start, end = piece_accelerations(motion.times, motion.positions, motion.velocities)
        assert (np.abs(end - start) / np.diff(motion.times)[:, None] <= made.jerk_limits * (1.0 + 1e-9)).all()
        np.testing.assert_allclose(end[:-1], start[1:], atol=1e-6)


SEEDS = st.integers(0, 2**32 - 1)
SLIGHT = 1e-11  # rounding [rad]: a hundredth of what the certificate lets pass


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


@settings(max_examples=18)
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


@settings(max_examples=18)
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
