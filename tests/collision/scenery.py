"""Robots among obstacles for the tests of this room."""

import functools
from typing import Any

import numpy as np

from guidefield.collision.world import World
from guidefield.messages import scene as messages
from guidefield.robot.group.group import PlanningGroup
from guidefield.scene.scene import build
from guidefield.stores import scenes
from tests.robots import group


@functools.cache
def panda_in(name: str) -> World:
    """A Panda at the origin of a packaged scene."""
    return World.build(group("panda"), build(scenes.read_packaged(name)))


def world_of(planned: PlanningGroup, obstacles: list[Any], allowed: Any = ()) -> World:
    """A robot among obstacles."""
    return World.build(planned, build(messages.Scene(name="test", obstacles=obstacles)), allowed)


def box(name: str, size: Any, position: Any) -> messages.Box:
    """A box along the axes."""
    return messages.Box(name=name, size=tuple(map(float, size)), position=tuple(map(float, position)))


def scattered(rng: np.random.Generator, count: int, reach: float = 0.9) -> list[Any]:
    """Small obstacles of every kind, strewn about an arm at the origin."""
    obstacles: list[Any] = []
    for index in range(count):
        direction = rng.normal(size=3)
        position = direction / np.linalg.norm(direction) * rng.uniform(0.4, reach) + [0, 0, 0.4]
        q = rng.normal(size=4)
        size = rng.uniform(0.02, 0.15, 3).tolist()
        name = f"o{index}"
        place = {"position": tuple(position.tolist()), "quaternion_xyzw": tuple((q / np.linalg.norm(q)).tolist())}
        obstacles.append(
            [
                messages.Box(name=name, size=tuple(size), **place),
                messages.Sphere(name=name, radius=size[0], position=place["position"]),
                messages.Cylinder(name=name, radius=size[0], length=size[1], **place),
                messages.Capsule(name=name, radius=size[0], length=size[1], **place),
            ][index % 4]
        )
    return obstacles
