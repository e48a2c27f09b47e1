"""Trees within path constraints: paths don't jump, constraints are kept."""

from __future__ import annotations

import dataclasses
import time
from itertools import pairwise

import numpy as np
import pytest

from guidefield.deadline import Deadline
from guidefield.errors import Status
from guidefield.messages import scene as messages
from guidefield.planner.connect.connect import Keeper, connect_constrained
from guidefield.planner.connect.tree_search import FARTHEST_STRIDE, STRIDE
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


def apart(made: Problem, one: np.ndarray, other: np.ndarray) -> float:
    """By the group's metric, with no turn taken back."""
    return float(np.linalg.norm((other - one) / made.group.units))


def test_what_can_not_be_reached_is_told() -> None:
    made, keeper = upright("wide y", 0.3)  # once round, the second joint would have to turn by pi
    made = dataclasses.replace(made, deadline=Deadline(time.monotonic() + 0.2))
    start, goal = np.zeros(2), np.array([2.0 * np.pi, 0.0])
    assert (keeper.frames.values(goal) <= keeper.frames.limits).all()
    found = connect_constrained(made, keeper, start, goal[None], np.random.default_rng(0))
    assert found.status is Status.TIMED_OUT
    assert "within the path constraints no connection was found in time" in found.message
    np.testing.assert_array_equal(found.path, start[None])


@pytest.mark.parametrize("seed", range(4))
def test_a_path_keeps_the_constraint_and_never_jumps(seed: int) -> None:
    post = messages.Box(name="post", size=(0.2, 0.2, 1.0), position=(0.35, 0.35, 0.5))
    made, keeper = upright("continuous y oblique-continuous y", 0.7, post)
    rng, ends = np.random.default_rng(seed), []
    while len(ends) < 2:
        z = keeper.bring_back(made.group.chart(made.group.random(rng)))
        if z is not None and not made.lanes.touching(z[None])[0]:
            ends.append(z)
    found = connect_constrained(made, keeper, ends[0], np.array(ends[1:]), rng)
    assert found.status is Status.SUCCESS
    np.testing.assert_array_equal(found.path[0], ends[0])
    last, goal = (made.group.from_chart(z) for z in (found.path[-1], ends[1]))
    np.testing.assert_allclose(last, goal, atol=1e-9)
    for a, b in pairwise(found.path):
        assert apart(made, a, b) <= FARTHEST_STRIDE * STRIDE + 1e-6
        for t in (0.0, 0.5, 1.0):
            q = made.group.expand_from_chart(a + t * (b - a))
            axis = made.kinematics.frame_placement(q, made.group.tip_id).rotation[:, 2]
            assert np.arccos(np.clip(axis[2], -1.0, 1.0)) <= 0.7 + 1e-6
            assert not made.world.in_collision(q)
