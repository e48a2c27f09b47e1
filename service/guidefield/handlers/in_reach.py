"""In a large scene, and among very many obstacles, a robot is planned for among what it can meet."""

from __future__ import annotations

import dataclasses
from itertools import chain
from typing import TypeVar

from guidefield.collision.robot_reach import robot_reach
from guidefield.collision.world import World
from guidefield.deadline import Deadline
from guidefield.planner.task.conditions import Conditions
from guidefield.scene.nearest_to_ball import has_many, nearest_to_ball
from guidefield.scene.within_ball import is_large_scene, within_ball

Asked = TypeVar("Asked", bound=Conditions)


def in_reach(problem: Asked, deadline: Deadline, *, limited: bool = True) -> Asked:
    """A problem among what its robot can meet: distances from what is nearest are the same.

    Args:
        problem: The problem.
        deadline: Checked before each search.
        limited: Whether the joints keep their limits.

    Raises:
        DeadlineExpired: if time was up before.
    """
    scene = problem.scene
    many, large = has_many(scene), is_large_scene(scene)
    reach = robot_reach(problem.group, limited) if many or large else None
    if reach is None:
        return problem
    met, pairs = scene, problem.world.pairs
    if many:
        named = scene.names.intersection(chain.from_iterable(problem.allowed_collisions))
        deadline.check(f"what is in reach of scene {scene.name}")
        nearest = nearest_to_ball(scene, reach, named)
        if nearest.some is not None:
            met, pairs = nearest.some, pairs.among(nearest.chosen)
    if large:
        deadline.check(f"what is in reach of scene {scene.name}")
        met = within_ball(met, reach)
    if met is scene:
        return problem
    return dataclasses.replace(problem, scene=met, world=World(problem.group, met, pairs, problem.world.held_contacts))
