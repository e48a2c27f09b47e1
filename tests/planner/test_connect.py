"""Connections: straight where it is free, a tree where it isn't, and never anything uncertified."""

from __future__ import annotations

import time

import numpy as np
import pytest

from guidefield.errors import Status
from guidefield.messages import scene as messages
from guidefield.planner.connect import _spread, connect, shortcut
from guidefield.planner.problem import Budget
from guidefield.planner.tree import Tree
from tests.planner.problems import densely_free, problem, scene_of
from tests.robots import rest


def wall_between() -> tuple:
    """A Panda with a wall beside it, and chart points on both sides of the wall."""
    wall = messages.Box(name="wall", size=(0.5, 0.04, 0.7), position=(0.55, 0.0, 0.35))
    made = problem("panda", scene_of(wall))
    start, goal = made.group.chart(rest(made.group)), made.group.chart(rest(made.group))
    start[0], goal[0] = 0.9, -0.9
    start[1] = goal[1] = 0.3
    assert not made.world.in_collision(start)
    assert not made.world.in_collision(goal)
    return made, start, goal


def test_a_free_straight_motion_is_taken() -> None:
    made = problem("panda", scene_of())
    z = made.group.chart(made.q_start)
    goal = z + 0.2
    connection = connect(made, z, np.array([goal]), np.random.default_rng(0))
    assert connection.status is Status.SUCCESS
    np.testing.assert_array_equal(connection.path, [z, goal])


def test_of_several_goals_the_nearest_straight_one_is_taken() -> None:
    made = problem("panda", scene_of())
    z = made.group.chart(made.q_start)
    goals = np.array([z + 0.5, z + 0.1, z - 0.4])
    np.testing.assert_array_equal(connect(made, z, goals, np.random.default_rng(0)).path[-1], goals[1])


@pytest.mark.parametrize("seed", range(3))
def test_the_tree_finds_a_way_round_and_shortcuts_shorten_it(seed: int) -> None:
    made, start, goal = wall_between()
    assert not densely_free(made, np.array([start, goal]))
    connection = connect(made, start, np.array([goal]), np.random.default_rng(seed))
    assert connection.status is Status.SUCCESS
    np.testing.assert_array_equal(connection.path[0], start)
    np.testing.assert_array_equal(connection.path[-1], goal)
    assert densely_free(made, connection.path)
    shorter = shortcut(made, connection.path, np.random.default_rng(seed))
    length, found = (np.linalg.norm(np.diff(path, axis=0), axis=1).sum() for path in (shorter, connection.path))
    assert length <= found + 1e-9
    assert densely_free(made, shorter)
    np.testing.assert_array_equal(shorter[[0, -1]], connection.path[[0, -1]])


def test_what_need_not_be_proven_is_what_lanes_found() -> None:
    made, start, goal = wall_between()
    proven, proposed = (
        connect(made, start, np.array([goal]), np.random.default_rng(3), prove=prove) for prove in (True, False)
    )
    assert proven.proven
    assert proposed.status is Status.SUCCESS
    assert not proposed.proven
    np.testing.assert_array_equal(proposed.path[[0, -1]], [start, goal])
    assert not any(made.world.in_collision(made.group.from_chart(z)) for z in proposed.path)


def test_the_same_seed_gives_the_same_path() -> None:
    paths = []
    for _ in range(2):
        made, start, goal = wall_between()
        paths.append(connect(made, start, np.array([goal]), np.random.default_rng(5)).path)
    np.testing.assert_array_equal(*paths)


def test_a_continuous_joint_goes_the_short_way_round() -> None:
    made = problem("kinova", scene_of())
    z = made.group.chart(made.q_start)
    goal = z.copy()
    goal[0] += 2.0 * np.pi - 0.3
    connection = connect(made, z, np.array([goal]), np.random.default_rng(0))
    assert connection.status is Status.SUCCESS
    assert np.abs(connection.path[-1] - z).max() == pytest.approx(0.3)


def test_no_way_in_time_is_said_so() -> None:
    made, start, goal = wall_between()
    stopped = problem("panda", made.scene, budget=Budget(time.monotonic()))
    connection = connect(stopped, start, np.array([goal]), np.random.default_rng(0))
    assert connection.status is Status.TIMED_OUT
    assert len(connection.path) == 1


def test_min_clearance_is_kept_all_along() -> None:
    made, start, goal = wall_between()
    careful = problem("panda", made.scene, min_clearance=0.03)
    connection = connect(careful, start, np.array([goal]), np.random.default_rng(1))
    assert connection.status is Status.SUCCESS
    for a, b in zip(connection.path, connection.path[1:], strict=False):
        for t in np.linspace(0, 1, 20):
            assert careful.world.clearance(a + t * (b - a)).obstacle_distance >= 0.03


def test_samples_of_an_edge_are_spread_before_they_are_dense() -> None:
    for count in (1, 2, 7, 32, 33):
        order = _spread(count)
        assert sorted(order) == list(range(1, count + 1))
        assert order[0] == count
    assert _spread(8)[1] == 4


def test_nearest_wraps_angles() -> None:
    tree = Tree(np.array([[3.0, 0.0], [0.0, 0.0]]))
    assert tree.nearest(np.array([-3.0, 0.0]), np.array([2 * np.pi, np.inf])) == 0
    assert tree.nearest(np.array([-3.0, 0.0]), np.array([np.inf, np.inf])) == 1
    for i in range(200):
        assert tree.add(np.array([float(i), 1.0]), i) == i + 2
    np.testing.assert_array_equal(tree.branch(4)[0], tree.point(0))
