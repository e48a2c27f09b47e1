"""Refused motions are repaired; motions that begin or end in motion do so exactly, or are refused with the joint."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from guidefield.errors import Status
from guidefield.messages import scene as messages
from guidefield.messages.scene import Sphere
from guidefield.planner import finish as module, optimized_motion
from guidefield.planner.finish import REPAIRS, STOPPING, certify_found_path, finish, remove_waypoints
from guidefield.planner.motion.limit_load import measure_limit_load
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.optimize.optimization import Optimized, optimize
from guidefield.planner.optimize.passages import REACHED
from guidefield.planner.optimize.settings import BALANCED, OptimizationSettings, closer, free, in_few_pieces
from guidefield.planner.optimized_motion import MAX_RETRIES
from guidefield.planner.path_so_far import PathSoFar, time_path_ignoring_jerk
from guidefield.planner.plan import Plan, Planner, plan
from guidefield.planner.task.problem import ConfigurationGoal, Problem
from guidefield.planner.task.stages import Stages, make_refusal
from guidefield.prove.certificate import certify
from guidefield.prove.verdict import Reason
from guidefield.scene.guide_plane import build
from tests.planner.problems import over_the_wall, problem, scene_of, smallest_clearance


def through_the_wall(made: Problem, path: np.ndarray) -> Trajectory:
    """The straight motion, which touches the wall."""
    return time_path_ignoring_jerk(made, path[[0, -1]])


def misled(monkeypatch: pytest.MonkeyPatch, trajectories: Sequence[Trajectory]) -> list[OptimizationSettings]:
    """Has optimisations give trajectories that touch, the first so many; how each was asked for."""
    asked: list[OptimizationSettings] = []

    def mislead(problem: Problem, motion: Trajectory, settings: OptimizationSettings, *_: Any, **__: Any) -> Optimized:
        asked.append(settings)
        optimized = optimize(problem, motion, settings)
        if len(asked) <= len(trajectories):
            return dataclasses.replace(optimized, trajectory=trajectories[len(asked) - 1])
        return optimized

    monkeypatch.setattr(optimized_motion, "optimize", mislead)
    return asked


def test_a_refused_motion_is_optimised_again_looking_closer(monkeypatch: pytest.MonkeyPatch) -> None:
    made, path = over_the_wall()
    asked = misled(monkeypatch, [through_the_wall(made, path)])
    stages = Stages(made)
    finished = finish(made, PathSoFar(path, proven=False), stages)
    begun = in_few_pieces(free(BALANCED))
    assert asked == [begun, closer(begun)]
    assert finished.verdict.free
    assert finished.warnings == ()
    assert certify(made.world, finished.trajectory.bezier()).free
    assert smallest_clearance(made, finished.path, 0.3) > 0.03
    assert [stage.outcome for stage in stages.left if stage.name == "certify"] == ["contact", "free"]


def test_a_motion_that_nothing_repairs_is_the_one_that_was_found(monkeypatch: pytest.MonkeyPatch) -> None:
    made, path = over_the_wall()
    misled(monkeypatch, 2 * (2 + MAX_RETRIES) * [through_the_wall(made, path)])
    finished = finish(made, PathSoFar(path), Stages(made))
    assert finished.verdict.free
    np.testing.assert_array_equal(finished.path[[0, -1]], path[[0, -1]])
    assert "the optimised motion was not certified (contact)" in finished.warnings[0]
    assert "as it was found" in finished.warnings[0]
    assert not finish(made, PathSoFar(path, proven=False), Stages(made)).verdict.free


def guided_over_the_wall() -> tuple[Problem, np.ndarray, dict[int, int]]:
    """The same with a plane at the path's middle."""
    made, path = over_the_wall()
    middle = len(path) // 2
    tip = made.kinematics.tip_position(made.group.expand_from_local(path[middle]))
    corners = [tip + 0.1 * np.array([a, 0.0, b]) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    plane = build(messages.GuidePlane(name="GP", vertices=[tuple(c.tolist()) for c in corners]), 0)
    return dataclasses.replace(made, guide_planes=(plane,)), path, {0: middle}


def test_an_optimised_guided_motion_crosses_its_plane_where_its_knot_says() -> None:
    made, path, crossings = guided_over_the_wall()
    finished = finish(made, PathSoFar(path, crossings, proven=False), Stages(made))
    assert finished.verdict.free
    assert finished.warnings == ()
    tip = made.kinematics.tip_position(made.group.expand_from_local(finished.path[finished.crossings[0]]))
    assert abs(made.guide_planes[0].signed_height(tip)) <= REACHED
    assert made.guide_planes[0].contains(tip)
    assert (
        finished.trajectory.duration
        < certify_found_path(made, PathSoFar(path, crossings), Stages(made)).trajectory.duration
    )


def test_what_is_refused_round_corners_is_drawn_closer_and_stops_at_them_in_the_end(monkeypatch):
    made, path, crossings = guided_over_the_wall()
    asked, closeness = dataclasses.replace(made, optimization_iterations=0), list[int]()

    def refused(*asked_for: Any) -> tuple[Trajectory, dict[int, int]]:
        closeness.append(asked_for[-1])
        return through_the_wall(made, path), {}

    monkeypatch.setattr(module, "_round_corners", refused)
    finished = finish(asked, PathSoFar(path, crossings), Stages(asked))
    assert closeness == [2**k for k in range(REPAIRS + 1)]
    assert finished.verdict.free
    assert finished.warnings == (STOPPING,)
    for waypoint in path:
        (knots,) = np.nonzero((finished.path == waypoint).all(axis=1))
        assert not finished.trajectory.velocities[knots].any()
    np.testing.assert_array_equal(finished.path[finished.crossings[0]], path[crossings[0]])


def test_an_end_beyond_a_limit_is_refused_by_joint_value_limits_and_place() -> None:
    made, path = over_the_wall()
    joint, upper = made.group.joints[0], float(made.group.upper[0])
    beyond = path.copy()
    beyond[0, 0] = upper + 0.01
    stages = Stages(made)
    refused = finish(made, PathSoFar(beyond, proven=False), stages).verdict
    # a motion that is drawn closer to a path that is beyond a limit would be, too: it is not tried
    assert [stage.outcome for stage in stages.left if stage.name == "certify"] == ["beyond limits"] * 2
    assert (refused.reason, refused.piece) == (Reason.BEYOND_LIMITS, 0)
    ending = make_refusal(made, refused)
    details = ending.details
    assert ending.status is Status.INVALID_MOTION_PLAN
    assert f"joint {joint.name} reaches {upper + 0.01:.6g}, 0.01 beyond its limits" in ending.message
    assert (details["joint"], details["limits"]) == (joint.name, [made.group.lower[0], upper])
    assert details["value"] == pytest.approx(upper + 0.01)
    assert details["excess"] == pytest.approx(0.01)
    assert details["configuration"][joint.name] == pytest.approx(upper + 0.01)


def asked(**options: Any) -> Problem:
    """From one side of the wall to the other."""
    made, path = over_the_wall()
    goal = ConfigurationGoal((made.group.from_local(path[-1]),))
    start = made.group.from_local(path[0])
    return dataclasses.replace(made, guide_planes=(), q_start=start, goal=goal, **options)


def check(made: Problem, result: Plan) -> Trajectory:
    """That a motion is free and within limits, and has the ends that were asked for."""
    assert result.status is Status.SUCCESS, result.message
    motion, group = result.trajectory, made.group
    assert certify(made.world, motion.bezier()).free
    jerk = np.full(group.nv, np.inf) if made.jerk_limits is None else made.jerk_limits
    knots = motion.times, motion.positions, motion.velocities
    assert measure_limit_load(*knots, group.velocity_limits, group.acceleration_limits, jerk) <= 1.0 + 1e-9
    q, v, a = motion.evaluate(np.array([0.0, motion.duration]))
    np.testing.assert_allclose(q[0], made.z_start, atol=1e-12)
    np.testing.assert_allclose(q[1], group.to_local(made.goal.configurations[0]), atol=1e-9)
    np.testing.assert_allclose(v, [made.start_rates, made.end_rates], atol=1e-12)
    if made.start_acceleration is not None:
        np.testing.assert_allclose(a[0], made.start_acceleration, atol=1e-6 * group.acceleration_limits.max())
    return motion


@pytest.mark.parametrize("jerk", [None, 500.0])
def test_it_begins_and_ends_as_asked_and_does_not_stop(jerk: float | None) -> None:
    made = asked()
    top, nv = made.group.velocity_limits, made.group.nv
    rng = np.random.default_rng(0)
    made = dataclasses.replace(
        made,
        jerk_limits=None if jerk is None else np.full(nv, jerk),
        start_velocity=rng.uniform(-0.5, 0.5, nv) * top,
        start_acceleration=rng.uniform(-0.3, 0.3, nv) * made.group.acceleration_limits,
        end_velocity=rng.uniform(-0.3, 0.3, nv) * top,
    )
    result = plan(made, Planner.TREE)
    motion = check(made, result)
    assert result.warnings == ()
    assert [stage.outcome for stage in result.stages if stage.name == "relax"] == ["optimised"]
    speeds = np.abs(motion.evaluate(np.linspace(0.0, motion.duration, 500))[1]).max(axis=1)
    assert speeds.min() > 0.05


def test_an_optimised_motion_beyond_limits_is_not_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("guidefield.planner.optimize.optimization.STRICTLY", 1.5)  # it begins beyond them
    made = asked()
    top, nv = made.group.velocity_limits, made.group.nv
    made = dataclasses.replace(
        made, jerk_limits=np.full(nv, 500.0), start_velocity=0.3 * top, optimization_iterations=1
    )
    result = plan(made, Planner.TREE)
    check(made, result)


def test_a_joint_may_begin_at_its_velocity_limit() -> None:
    made = asked()
    made = dataclasses.replace(made, start_velocity=made.group.velocity_limits * np.eye(made.group.nv)[0])
    result = plan(made, Planner.TREE)
    assert result.warnings == ()
    check(made, result)


def test_a_joint_that_is_too_near_its_limit_cannot_stop_in_time() -> None:
    made = asked()
    group, z = made.group, made.z_start.copy()
    z[0] = group.upper[0] - 0.02
    fast = dataclasses.replace(made, q_start=group.from_local(z), start_velocity=2.0 * np.eye(group.nv)[0])
    result = plan(fast, Planner.TREE)
    assert result.status is Status.START_STATE_INVALID
    assert "panda_joint1 can't stop in time: at 2 it takes" in result.message
    assert "is 0.02 away" in result.message
    assert result.details["joint"] == "panda_joint1"
    assert result.trajectory is None
    slow = dataclasses.replace(fast, start_velocity=0.3 * np.eye(group.nv)[0])
    check(slow, plan(slow, Planner.TREE))


def test_a_goal_that_is_too_near_a_limit_cannot_be_reached_at_speed() -> None:
    made = asked()
    group, z = made.group, made.z_start.copy()
    z[0] = group.lower[0] + 0.02
    goal = ConfigurationGoal((group.from_local(z),))
    fast = dataclasses.replace(made, goal=goal, end_velocity=2.0 * np.eye(group.nv)[0])
    result = plan(fast, Planner.TREE)
    assert result.status is Status.GOAL_STATE_INVALID
    assert "panda_joint1 can't get up to speed in time" in result.message


def test_what_stands_in_the_way_of_stopping_is_named() -> None:
    open_ = problem("panda", scene_of(), planes=())
    group, one = open_.group, np.eye(open_.group.nv)[0]
    tip = open_.kinematics.tip_position(group.expand_from_local(open_.z_start + 0.6 * one))
    made = problem("panda", scene_of(Sphere(name="near", radius=0.05, position=tuple(tip.tolist()))), planes=())
    turned = [made.z_start + shift * one for shift in np.arange(0.59, 0.0, -0.01)]
    z = next(z for z in turned if not made.world.in_collision(group.expand_from_local(z)))
    goal = ConfigurationGoal((group.from_local(made.z_start),))
    there = dataclasses.replace(made, goal=goal, q_start=group.from_local(z), start_velocity=2.0 * one)
    result = plan(there, Planner.TREE)
    assert result.status is Status.START_STATE_INVALID
    assert "the robot can't stop in time: contact between" in result.message
    assert "near" in result.details["pair"]
    assert result.details["joint"] == "panda_joint1"


@pytest.mark.parametrize(
    ("field", "share", "status", "says"),
    [
        ("start_velocity", 1.1, Status.START_STATE_INVALID, "`start_velocities` has joint panda_joint1 at"),
        ("end_velocity", -1.1, Status.GOAL_STATE_INVALID, "`end_velocities` has joint panda_joint1 at"),
    ],
)
def test_rates_beyond_limits_are_refused(field: str, share: float, status: Status, says: str) -> None:
    made = asked()
    rates = share * made.group.velocity_limits * np.eye(made.group.nv)[0]
    result = plan(dataclasses.replace(made, **{field: rates}), Planner.TREE)
    assert result.status is status
    assert says in result.message


FREE = problem("panda", scene_of())


def wandering(seed: int, steps: int) -> np.ndarray:
    """A path of small steps about a straight one."""
    rng = np.random.default_rng(seed)
    along = np.linspace(0.0, 1.0, steps)[:, None] * rng.uniform(-0.5, 0.5, FREE.group.nv)
    return FREE.z_start + along + rng.normal(scale=0.02, size=along.shape)


@given(st.integers(0, 1000), st.integers(3, 12), st.data())
def test_a_path_in_the_open_is_straight_between_its_crossings(seed: int, steps: int, data: st.DataObject) -> None:
    path = wandering(seed, steps)
    at = data.draw(st.lists(st.integers(0, steps - 1), max_size=3))
    fewer = remove_waypoints(FREE, path, dict(enumerate(at)))
    np.testing.assert_allclose(fewer, path[sorted({0, steps - 1, *at})], atol=1e-6, err_msg="kernels go in float32")
    np.testing.assert_array_equal(fewer[[0, -1]], path[[0, -1]])
