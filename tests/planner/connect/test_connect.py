"""Connections: straight where it is free, a tree where it isn't, and never anything uncertified."""

from __future__ import annotations

import time
from itertools import pairwise

import numpy as np
import pytest

from guidefield.collision.clearance import clearance_at
from guidefield.deadline import Deadline
from guidefield.errors import Status
from guidefield.messages import scene as messages
from guidefield.planner.connect.connect import connect
from guidefield.planner.guide.guide import ATTEMPTS, cross_plane
from tests.collision.lanes.test_lanes import draw
from tests.planner.problems import densely_free, problem, scene_of, seed_problem
from tests.robots import box_arm, group, grouped, rest


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


@pytest.mark.parametrize("seed", range(3))
def test_the_tree_finds_a_way_round(seed: int) -> None:
    made, start, goal = wall_between()
    assert not densely_free(made, np.array([start, goal]))
    connection = connect(made, start, np.array([goal]), np.random.default_rng(seed))
    assert connection.status is Status.SUCCESS
    np.testing.assert_array_equal(connection.path[0], start)
    np.testing.assert_array_equal(connection.path[-1], goal)
    assert densely_free(made, connection.path)


@pytest.mark.parametrize("kinds", ["ball", "free ball", "planar", "floating x", "x planar y", "slide floating mimic"])
def test_joints_of_every_kind_find_a_way_round(kinds: str) -> None:
    names = {"ball": "chain_fixed_6x300_r25", "free ball": "chain_moving_3x260_r20", "planar": "chain_planar_3x260_r25"}
    planned = group(names[kinds]) if kinds in names else grouped(box_arm(kinds, len(kinds.split())))
    turned = (0.0, 0.6, 0.0, 0.8)
    walls = [
        messages.Box(name="near", size=(0.4, 0.8, 0.04), position=(0.35, 0.0, 0.1), quaternion_xyzw=turned),
        messages.Box(name="far", size=(0.05, 1.0, 1.0), position=(-0.7, 0.3, 0.1), quaternion_xyzw=turned),
    ]
    made = problem(planned, scene_of(*walls))
    zs = draw(planned, 400, 7)
    ends = zs[~made.lanes.touching(zs)]
    ways = [(start, planned.unwrapped(goal, start)) for start, goal in pairwise(ends)]
    blocked = [way for way in ways if not made.lanes.free_until(np.array(way), 32.0)]
    assert len(blocked) > 2
    for start, goal in blocked[:3]:
        connection = connect(made, start, goal[None], np.random.default_rng(0))
        assert connection.status is Status.SUCCESS
        assert "tree" in connection.message
        assert connection.proven
        np.testing.assert_array_equal(connection.path[0], start)
        assert np.abs(planned.difference(*map(planned.from_chart, (connection.path[-1], goal)))).max() < 1e-6
        for a, b in pairwise(connection.path):
            for t in np.linspace(0.0, 1.0, 1 + int(np.linalg.norm(b - a) / 0.05)):
                assert not made.world.in_collision(planned.expand_from_chart(a + t * (b - a)))


def test_a_body_that_flies_free_gets_there_turned_the_other_way_round_too() -> None:
    planned = grouped(box_arm("floating", 1))
    goal = planned.chart(planned.q_origin)
    goal[3:6] = 0.0, 2.5, 0.0
    (other,) = planned.turned_otherwise(goal)
    np.testing.assert_allclose(planned.from_chart(other)[:3], planned.from_chart(goal)[:3])
    same = planned.difference(planned.from_chart(other), planned.from_chart(goal))
    np.testing.assert_allclose(same, np.zeros(planned.nv), atol=1e-9)
    assert np.linalg.norm(other[3:6]) == pytest.approx(2.0 * np.pi - 2.5)


def test_no_way_in_time_is_said_so() -> None:
    made, start, goal = wall_between()
    stopped = problem("panda", made.scene, deadline=Deadline(time.monotonic()))
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
            assert clearance_at(careful.world, a + t * (b - a)).obstacle_distance >= 0.03


@pytest.mark.parametrize("title", ["seed_e_L_3", "seed_e_S_3", "seed_e_L_6_planar", "seed_d_passage_3"])
def test_snakes_go_through_tubes_to_configurations(title: str) -> None:
    made = seed_problem(title)
    q = made.q_start
    for index, plane in enumerate(made.guide_planes):
        q = cross_plane(made, q, plane, index, ATTEMPTS["projected"](made.group)).path[-1]
    start = made.group.chart(made.q_start)
    goal = made.group.unwrapped(made.group.chart(q), start)
    assert not densely_free(made, np.array([start, goal]), 1e-2)
    connection = connect(made, start, goal[None], np.random.default_rng(0))
    assert connection.status is Status.SUCCESS
    assert connection.proven
    np.testing.assert_array_equal(connection.path[0], start)
    reached = made.group.unwrapped(connection.path[-1], goal)
    np.testing.assert_allclose(reached, goal, atol=1e-9)
    assert densely_free(made, connection.path, 1e-2)
