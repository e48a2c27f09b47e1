"""Trees within path constraints: angles that wrap go the short way round, paths don't jump, constraints are kept."""

from __future__ import annotations

import dataclasses
from itertools import pairwise

import numpy as np
import pytest

from guidefield.errors import Status
from guidefield.messages import scene as messages
from guidefield.planner.connect.constrained_tree import Keeper, connect_constrained
from guidefield.planner.connect.settings import CONSTRAINED
from guidefield.planner.connect.tree import Tree
from guidefield.planner.task.problem import Problem
from guidefield.robot.group.path_constraints import Cone
from tests.planner.problems import problem, scene_of
from tests.robots import box_arm, grouped


def upright(arm: str, half_angle: float, *obstacles: messages.Obstacle) -> tuple[Problem, Keeper]:
    """An arm whose tip's z axis stays within a cone about the world's."""
    planned = grouped(box_arm(arm, len(arm.split())))
    up = np.array([0.0, 0.0, 1.0])
    made = problem(planned, scene_of(*obstacles), planes=())
    made = dataclasses.replace(made, path_constraints=(Cone(planned.tip, up, up, half_angle),))
    return made, Keeper(made, made.constrained_frames)


def test_a_step_goes_the_short_way_round() -> None:
    made, keeper = upright("continuous", 6.0)  # wide enough for any angle
    origin, target = np.array([3.0]), np.array([-3.0])
    steps = keeper.steps(origin, target)
    assert len(steps) == int(np.ceil((2.0 * np.pi - 6.0) / CONSTRAINED.stride))
    assert all(abs(b - a) <= CONSTRAINED.stride + 1e-12 for a, b in pairwise([origin, *steps]))
    np.testing.assert_allclose(steps[-1], 2.0 * np.pi - 3.0, atol=1e-12)
    np.testing.assert_allclose(made.group.from_chart(steps[-1]), made.group.from_chart(target), atol=1e-12)


def test_the_nearest_node_is_by_the_metric_and_the_short_way_round() -> None:
    planned = grouped(box_arm("continuous slide", 2))
    nodes = np.array([[3.0, 0.0], [0.0, 0.0], [-2.0, 0.3]])
    tree = Tree(planned, nodes)
    for point in (np.array([-3.0, 0.0]), np.array([9.0, 0.0]), np.array([-0.9, 0.15]), np.array([-1.2, 0.2])):
        turns = (np.remainder(nodes[:, 0] - point[0] + np.pi, 2.0 * np.pi) - np.pi)[:, None]
        apart = np.hypot(turns[:, 0], (nodes[:, 1] - point[1]) / planned.units[1])
        assert tree.nearest(point) == int(np.argmin(apart))
    assert tree.nearest(np.array([-3.0, 0.0])) == 0


@pytest.mark.parametrize("seed", range(4))
def test_a_path_keeps_the_constraint_and_never_jumps(seed: int) -> None:
    post = messages.Box(name="post", size=(0.2, 0.2, 1.0), position=(0.35, 0.35, 0.5))
    made, keeper = upright("continuous y oblique-continuous y", 0.7, post)
    rng, ends = np.random.default_rng(seed), []
    while len(ends) < 2:
        z = keeper.brought_back(made.group.chart(made.group.random(rng)))
        if z is not None and not made.lanes.touching(z[None])[0]:
            ends.append(z)
    found = connect_constrained(made, keeper, ends[0], np.array(ends[1:]), rng)
    assert found.status is Status.SUCCESS
    np.testing.assert_array_equal(found.path[0], ends[0])
    last, goal = (made.group.from_chart(z) for z in (found.path[-1], ends[1]))
    np.testing.assert_allclose(last, goal, atol=1e-9)
    for a, b in pairwise(found.path):
        assert keeper.apart(a, b) <= 2.0 * CONSTRAINED.stride
        for t in (0.0, 0.5, 1.0):
            q = made.group.expand_from_chart(a + t * (b - a))
            axis = made.kinematics.frame_placement(q, made.group.tip_id).rotation[:, 2]
            assert np.arccos(np.clip(axis[2], -1.0, 1.0)) <= 0.7 + 1e-9
            assert not made.world.in_collision(q)
