"""A ball among the obstacles: whether something of that size would fit at a place at all."""

from __future__ import annotations

import coal
import numpy as np

from guidefield.scene.scene import Scene


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
        if coal.collide(obstacle.shape, there, ball, at, request, result):
            return obstacle.name
    return None
