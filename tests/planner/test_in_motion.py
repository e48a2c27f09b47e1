"""Motions that begin or end in motion: exactly so, within limits, certified, and refused where a joint can't stop."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from guidefield.errors import Status
from guidefield.messages.scene import Sphere
from guidefield.planner.motion.limit_load import measure_limit_load
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.plan import Plan, Planner, plan
from guidefield.planner.task.problem import ConfigurationGoal, Problem
from guidefield.prove.certificate import certify
from tests.planner.problems import problem, scene_of
from tests.planner.walls import over_the_wall


def asked(**options: Any) -> Problem:
    """From one side of the wall to the other."""
    made, path = over_the_wall()
    goal = ConfigurationGoal((made.group.from_chart(path[-1]),))
    start = made.group.from_chart(path[0])
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
    np.testing.assert_allclose(q[1], group.chart(made.goal.configurations[0]), atol=1e-9)
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
    fast = dataclasses.replace(made, q_start=group.from_chart(z), start_velocity=2.0 * np.eye(group.nv)[0])
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
    goal = ConfigurationGoal((group.from_chart(z),))
    fast = dataclasses.replace(made, goal=goal, end_velocity=2.0 * np.eye(group.nv)[0])
    result = plan(fast, Planner.TREE)
    assert result.status is Status.GOAL_STATE_INVALID
    assert "panda_joint1 can't get up to speed in time" in result.message


def test_what_stands_in_the_way_of_stopping_is_named() -> None:
    open_ = problem("panda", scene_of(), planes=())
    group, one = open_.group, np.eye(open_.group.nv)[0]
    tip = open_.kinematics.tip_position(group.expand_from_chart(open_.z_start + 0.6 * one))
    made = problem("panda", scene_of(Sphere(name="near", radius=0.05, position=tuple(tip.tolist()))), planes=())
    turned = [made.z_start + shift * one for shift in np.arange(0.59, 0.0, -0.01)]
    z = next(z for z in turned if not made.world.in_collision(group.expand_from_chart(z)))
    goal = ConfigurationGoal((group.from_chart(made.z_start),))
    there = dataclasses.replace(made, goal=goal, q_start=group.from_chart(z), start_velocity=2.0 * one)
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
