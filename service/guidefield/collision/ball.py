"""A ball among the obstacles: whether something of that size would fit at a place at all."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import coal
import numpy as np

from guidefield.geometry.met import as_met
from guidefield.scene.obstacle import Obstacle
from guidefield.scene.scene import Scene

_ROUNDING = 1e-9
"""What a reach is wider by, for rounding [m]."""


def obstacle_touched(scene: Scene, centre: np.ndarray, radius: float) -> str | None:
    """Name of an obstacle that a ball touches, or None.

    Args:
        scene: The obstacles.
        centre: Centre of the ball, shape (3,) [m, world].
        radius: Its radius [m].
    """
    ball = coal.Sphere(max(radius, 1e-9))
    at = coal.Transform3s(np.eye(3), np.asarray(centre, float))
    request, result = coal.CollisionRequest(), coal.CollisionResult()
    for obstacle in scene.obstacles:
        result.clear()
        request.security_margin = obstacle.rounding
        there = coal.Transform3s(obstacle.placement.rotation, obstacle.placement.translation)
        for shape in _near(obstacle, np.asarray(centre, float), radius + obstacle.rounding):
            first, second = as_met(shape, ball)
            if coal.collide(first, there, second, at, request, result):
                return obstacle.name
    return None


def _near(obstacle: Obstacle, centre: np.ndarray, reach: float) -> Iterator[Any]:
    """Coal shapes that are all of an obstacle that comes within reach of a place [m]."""
    patches = None if obstacle.facets is None else obstacle.facets.patches
    if patches is None:
        yield obstacle.shape
        return
    local = obstacle.placement.actInv(centre)
    for apart, patch in patches.nearest_first(local, local):
        if apart > reach + _ROUNDING:
            return
        yield patches.shape(patch)
