"""Of a large scene a robot is planned for among what it can meet."""

from __future__ import annotations

import dataclasses
from typing import TypeVar

from guidefield.aside import Spent, done_aside
from guidefield.collision.robot_reach import robot_reach
from guidefield.collision.world import World
from guidefield.planner.task.conditions import Conditions
from guidefield.scene.within_ball import is_large_scene, within_ball

Asked = TypeVar("Asked", bound=Conditions)


def in_reach(problem: Asked, spent: Spent, *, limited: bool = True) -> Asked:
    """A problem among what its robot can meet: all distances are the same, and so are pairs and field.

    Args:
        problem: The problem.
        spent: Whether time is up.
        limited: Whether the joints keep their limits.

    Raises:
        StoppedError: if time was up before.
    """
    scene = problem.scene
    reach = robot_reach(problem.group, limited) if is_large_scene(scene) else None
    if reach is None:
        return problem
    met = done_aside(lambda: within_ball(scene, reach), spent, lambda: f"what is in reach of scene {scene.name}")
    if met is scene:
        return problem
    return dataclasses.replace(problem, scene=met, world=World(problem.group, met, problem.world.pairs))
