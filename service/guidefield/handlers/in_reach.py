"""In a large scene, and among very many obstacles, a robot is planned for among what it can meet."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial
from itertools import chain
from typing import TypeVar

from guidefield.aside import Spent, done_aside
from guidefield.collision.robot_reach import robot_reach
from guidefield.collision.world import World
from guidefield.planner.task.conditions import Conditions
from guidefield.scene.nearest_to_ball import Nearest, has_many, nearest_to_ball
from guidefield.scene.scene import Scene
from guidefield.scene.within_ball import is_large_scene, within_ball

MANY_ASIDE, FEW_ASIDE = 20_000, 500
"""Among fewer obstacles, and fewer that move or are no primitives, what is nearest is found within milliseconds."""

Asked = TypeVar("Asked", bound=Conditions)


def in_reach(problem: Asked, spent: Spent, *, limited: bool = True) -> Asked:
    """A problem among what its robot can meet: distances from what is nearest are the same.

    Args:
        problem: The problem.
        spent: Whether time is up.
        limited: Whether the joints keep their limits.

    Raises:
        StoppedError: if time was up before.
    """
    scene = problem.scene
    many, large = has_many(scene), is_large_scene(scene)
    reach = robot_reach(problem.group, limited) if many or large else None
    if reach is None:
        return problem
    met, pairs = scene, problem.world.pairs
    if many:
        named = scene.names.intersection(chain.from_iterable(problem.allowed_collisions))
        nearest = _in_time(partial(nearest_to_ball, scene, reach, named), scene, spent)
        if nearest.some is not None:
            met, pairs = nearest.some, pairs.among(nearest.chosen)
    if large:
        met = done_aside(partial(within_ball, met, reach), spent, lambda: _doing(scene))
    if met is scene:
        return problem
    return dataclasses.replace(problem, scene=met, world=World(problem.group, met, pairs, problem.world.held_contacts))


def _doing(scene: Scene) -> str:
    return f"what is in reach of scene {scene.name}"


def _in_time(find: Callable[[], Nearest], scene: Scene, spent: Spent) -> Nearest:
    """What is nearest, aside where it may take long."""
    if len(scene.obstacles) >= MANY_ASIDE or len(scene.others) >= FEW_ASIDE:
        return done_aside(find, spent, lambda: _doing(scene))
    return find()
