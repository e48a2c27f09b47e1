"""Time among what moves: slices against Coal, and guided plans that wait, give way and say why they can't."""

import dataclasses
from typing import Any

import numpy as np
import pytest
import scipy.interpolate
from hypothesis import given, settings, strategies as st

from guidefield.collision.clearance import clearance_at, contacts_at
from guidefield.collision.world import World
from guidefield.errors import Status
from guidefield.messages import scene as messages
from guidefield.messages.values import Placement
from guidefield.planner.guide.guide import ATTEMPTS
from guidefield.planner.held_paths import find_quick_paths
from guidefield.planner.motion.trajectory import Trajectory, piece_accelerations
from guidefield.planner.path_so_far import PathSoFar
from guidefield.planner.plan import Plan, Planner, plan
from guidefield.planner.schedule import bezier, bound_slopes, clamp_smoothly, find_leaving
from guidefield.planner.slices import SCHEDULE, Slices, find_free_from, find_free_until
from guidefield.planner.task.problem import Problem
from guidefield.planner.task.stages import Ending
from guidefield.prove.curve import excesses
from tests.planner.guide.test_guide import plane_at
from tests.planner.problems import closed_shell, problem, scene_of, seed_problem
from tests.robots import group, rest

PANDA = group("panda")
START = PANDA.to_local(rest(PANDA))


def moved(*by: float) -> np.ndarray:
    """Local coordinates away from the start."""
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
                assert clearance_at(world, PANDA.expand_from_local(z)).obstacle_distance >= 0.01
        free += int((~touching).sum())
        middle = made.at((index + 0.5) * length).world
        nearest = np.array([clearance_at(middle, PANDA.expand_from_local(z)).obstacle_distance for z in zs])
        assert not touching[nearest > 0.1 * together].any(), "what is far is free"
    assert 0 < free < 5 * len(zs)


# ---- standing


def test_until_when_and_from_when_on_a_place_is_free_is_what_dense_times_say() -> None:
    made = asked(ball(trajectory=flight([0.5, 2.5], (0.35, -1.2, 0.6), (0.35, 1.2, 0.6))))
    times = np.arange(1.0, 2.2, 0.01)
    touching = [bool(contacts_at(World.build(PANDA, made.scene.at(t)), PANDA.expand_from_local(START))) for t in times]
    first, last = times[touching][0], times[touching][-1]
    until, refusal = find_free_until(made, START)
    assert first - 0.04 <= until <= first
    assert refusal.pair[1] == "ball"
    assert last <= find_free_from(made, START) <= last + 0.04
    away = moved(2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert find_free_until(asked(ball(trajectory=flight([0.0, 1.0], (2.0, 0.0, 0.5), (2.0, 1.0, 0.5)))), away) == (
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


def planned(made: Problem) -> Plan:
    return plan(made, Planner.GUIDED, ATTEMPTS["projected"](made.group))


def touches(made: Problem, found: Plan, count: int = 80, frozen: float | None = None) -> bool:
    """Whether a sample of the motion touches the obstacles as they then stand (or as they stood at one time)."""
    for time in np.linspace(0.0, found.trajectory.duration, count):
        z = found.trajectory.evaluate(np.array([time]))[0][0]
        if contacts_at(made.at(time if frozen is None else frozen).world, made.group.from_local(z)):
            return True
    return False


@pytest.mark.parametrize("title", ["door", "conveyor"])
def test_it_waits_for_what_moves_and_is_certified(title: str) -> None:
    made = seed_problem(title)
    found = planned(made)
    assert found.status is Status.SUCCESS, found.message
    assert found.verdict.free
    assert not touches(made, found)
    assert any(touches(made, found, frozen=time) for time in (0.0, 4.0, 6.0)), "it would have been in the way"
    samples = found.trajectory.evaluate(np.linspace(0.0, found.trajectory.duration, 4000))
    assert np.all(np.abs(samples[1]) <= made.group.velocity_limits)
    assert np.all(np.abs(samples[2]) <= made.group.acceleration_limits)
    for index, plane in enumerate(made.guide_planes):
        q = made.group.from_local(found.path[found.crossings[index]])
        assert abs(plane.signed_height(made.kinematics.tip_position(q))) <= 1e-4


@pytest.mark.parametrize("title", ["door", "conveyor"])
def test_optimised_in_time_it_is_sooner_and_does_not_rest_at_waypoints(title: str) -> None:
    made = seed_problem(title)
    shaped, found = planned(made), planned(dataclasses.replace(made, optimization_iterations=0))
    assert found.status is Status.SUCCESS
    assert shaped.trajectory.times[-1] < 0.9 * found.trajectory.times[-1]
    speeds = np.abs(shaped.trajectory.velocities).max(axis=1)
    assert (speeds[2:-1] > 0.0).all(), "but for a wait at the start and the end"
    assert shaped.crossings.keys() == found.crossings.keys() == set(range(len(made.guide_planes)))
    for index, plane in enumerate(made.guide_planes):
        tip = made.kinematics.tip_position(made.group.from_local(shaped.path[shaped.crossings[index]]))
        assert abs(plane.signed_height(tip)) <= 2e-6
        assert plane.distance(tip) <= 2e-6
    clearances = [
        min(
            clearance_at(made.at(now).world, made.group.from_local(z)).obstacle_distance
            for now, z in zip(times, one.trajectory.evaluate(times)[0], strict=True)
        )
        for one in (shaped, found)
        for times in (np.linspace(0.0, one.trajectory.times[-1], 60),)
    ]
    assert clearances[0] > min(0.02, 0.5 * clearances[1]), "room is bought, but not all of it"


@pytest.mark.parametrize(("jerk", "steps"), [(50.0, None), (500.0, 0)])
def test_jerk_limits_are_kept_in_time(jerk: float, steps: int | None) -> None:
    made = seed_problem("door")
    limits = np.full(made.group.nv, jerk)
    found = planned(dataclasses.replace(made, jerk_limits=limits, optimization_iterations=steps))
    assert found.status is Status.SUCCESS, found.message
    assert found.verdict.free
    assert not touches(made, found)
    samples = found.trajectory.evaluate(np.linspace(0.0, found.trajectory.times[-1], 4001))
    assert np.all(np.abs(samples[1]) <= made.group.velocity_limits)
    assert np.all(np.abs(samples[2]) <= made.group.acceleration_limits)
    # no jump of the acceleration either: between two samples it changes by what the jerk allows
    apart = found.trajectory.times[-1] / 4000.0
    assert np.abs(np.diff(samples[2], axis=0)).max() <= jerk * apart * (1.0 + 1e-6)
    assert np.abs(samples[2][[0, -1]]).max() <= 1e-9
    for index, plane in enumerate(made.guide_planes):
        tip = made.kinematics.tip_position(made.group.from_local(found.path[found.crossings[index]]))
        assert abs(plane.signed_height(tip)) <= 1e-4


def test_a_plane_is_the_goal_where_nothing_comes_to_the_robot_any_more() -> None:
    """A ball passes where the arm ends: it is there before that, or after."""
    still = problem("panda", scene_of(planes=[plane_at(0.6)]))
    end = planned(still).trajectory
    tip = still.kinematics.tip_position(still.group.from_local(end.positions[-1]))
    path = [Placement(position=tuple((tip + aside).tolist())) for aside in ([0.0, -0.8, 0.0], [0.0, 0.8, 0.0])]
    ball = messages.Sphere(name="ball", radius=0.05, trajectory=messages.ObstacleTrajectory([1.0, 3.0], path))
    made = problem("panda", scene_of(ball, planes=[plane_at(0.6)]))
    found = planned(made)
    assert found.status is Status.SUCCESS, found.message
    assert not touches(made, found)
    for now in np.arange(found.trajectory.times[-1], 3.1, 0.02).tolist():
        q = made.group.from_local(found.trajectory.positions[-1])
        assert not contacts_at(made.at(now).world, q), now


def test_planes_that_are_barred_at_a_time_are_tried_once_and_not_wherever_things_are_until_later() -> None:
    made, asked = seed_problem("door"), []

    def through(among: Problem, found: PathSoFar, _: bool) -> tuple[PathSoFar, None]:
        asked.append(len(among.scene.obstacles))
        return found.with_failure(Ending(Status.STUCK_IN_MINIMUM, "barred", {})), None

    assert not list(find_quick_paths(made, through))
    alone = len(made.scene.obstacles) - 1
    # until 2 s, at two of the moments that are looked at, the door is where it is at first
    assert asked == [alone, alone + 1, alone + 1, alone + 1]


def closing(until: float) -> Problem:
    """A shutter comes down in front of the arm, and stays."""
    down = messages.ObstacleTrajectory(
        times=[0.0, until], placements=[Placement(position=(0.75, 0.0, 1.8)), Placement(position=(0.75, 0.0, 0.5))]
    )
    shutter = messages.Box(name="shutter", size=(0.04, 3.0, 1.3), trajectory=down)
    return problem("panda", scene_of(shutter, planes=[plane_at(0.84, half=0.15, z=0.4)]))


def test_a_path_that_has_closed_is_told_with_the_time() -> None:
    found = planned(closing(0.2))
    assert found.status is Status.STUCK_IN_MINIMUM
    assert found.details["guide_plane"] == "GP"
    assert found.details["time"] == 0.2
    assert "path" not in found.details
    assert found.verdict.free


def test_what_hits_the_robot_is_named() -> None:
    """A wall sweeps through all that the arm can reach."""
    made = problem("panda", scene_of(planes=[plane_at(0.6)]))
    sweep = messages.ObstacleTrajectory(
        times=[0.0, 0.5], placements=[Placement(position=(2.0, 0.0, 0.8)), Placement(position=(-1.0, 0.0, 0.8))]
    )
    wall = messages.Box(name="wall", size=(0.1, 4.0, 2.0), trajectory=sweep)
    hit = problem("panda", scene_of(wall, planes=[made.scene.message.guide_planes[0]]))
    found = planned(hit)
    assert found.status is Status.START_STATE_INVALID
    assert found.details["pair"][1] == "wall"
    assert found.verdict.free
    assert dataclasses.replace(found).trajectory is None
