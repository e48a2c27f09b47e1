"""Where there is no way that is said, early where it is known, and with numbers where it isn't."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from guidefield.collision.world import World
from guidefield.deadline import Deadline
from guidefield.errors import Status
from guidefield.messages import scene as messages
from guidefield.planner.connect import tree_search
from guidefield.planner.connect.connect import connect
from guidefield.planner.connect.tree_search import explain_failed_search
from guidefield.robot.group.group import PlanningGroup
from tests.planner.connect.test_connect import wall_between
from tests.planner.problems import problem, scene_of
from tests.robots import box_arm, grouped


def one_joint(kind: str, *angles: float) -> tuple[PlanningGroup, list[messages.Box]]:
    """An upright link on one joint about y, and boxes that it meets at some angles."""
    planned = grouped(box_arm(kind, 1))
    boxes = [
        messages.Box(
            name=f"stop{i}",
            size=(0.03, 0.03, 0.03),
            position=(0.28 * np.sin(angle), 0.0, 0.3 + 0.28 * np.cos(angle)),
        )
        for i, angle in enumerate(angles)
    ]
    return planned, boxes


@pytest.mark.parametrize(("kind", "said"), [("y", "on the only way"), ("continuous", "either way round")])
def test_a_joint_that_is_stopped_on_every_way_is_known_not_to_get_there(kind: str, said: str) -> None:
    planned, boxes = one_joint(kind, 0.0, 1.9)
    made = problem(planned, scene_of(*boxes))
    connection = connect(made, np.array([-1.0]), np.array([[1.0]]), np.random.default_rng(0))
    assert connection.status is Status.PLANNING_FAILED
    assert said in connection.message
    assert planned.joints[0].name in connection.message
    assert made.counters.iterations == 0


def enclosed(gap: float) -> tuple[PlanningGroup, World, np.ndarray, np.ndarray]:
    """Two links that stand upright, the upper one between four walls, and a goal elsewhere."""
    planned, away = grouped(box_arm("x y", 2)), 0.02 + gap + 0.01
    walls = [
        messages.Box(name=f"{axis}{side}", size=(0.02, 0.02, 0.2), position=tuple(side * away * np.eye(3)[axis] + at))
        for axis in (0, 1)
        for side in (-1, 1)
        for at in [np.array([0.0, 0.0, 0.75])]
    ]
    world = World.build(planned, scene_of(*walls))
    return planned, world, np.zeros(2), np.array([1.5, 0.5])


def test_an_end_that_can_not_be_left_is_told_early() -> None:
    planned, world, start, goal = enclosed(0.001)
    assert not world.in_collision(planned.expand_from_chart(start))
    made = dataclasses.replace(problem(planned, world.scene), world=world)
    for ends, name in (((start, goal), "start"), ((goal, start), "goal")):
        connection = connect(made, ends[0], ends[1][None], np.random.default_rng(0))
        assert connection.status is Status.PLANNING_FAILED
        assert f"the {name} can't be left" in connection.message


def test_what_was_not_found_in_time_comes_with_numbers() -> None:
    made, start, goal = wall_between()
    calls = iter(range(100))
    deadline = Deadline(is_cancelled=lambda: next(calls) > 20)
    found = tree_search.grow(made.lanes, start[None], goal[None], 32.0, 2.0, np.random.default_rng(0), deadline)
    assert found.path is None
    message = explain_failed_search(found, 1, in_time=True)
    assert f"in time: {found.motions} motions were judged" in message
    assert "from the start and the goal have 1 and 1 configurations" in message
    assert "hard to get away from" in message
    assert sum(found.tried) <= found.motions
    assert "3000000" in explain_failed_search(found, 2, in_time=False)
