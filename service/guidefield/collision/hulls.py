"""Hulls in the place of meshes: what keeps apart from a hull keeps apart from the mesh in it, and is sooner tested."""

from __future__ import annotations

from typing import Any

import coal
import numpy as np

from guidefield.geometry.convex import convex, convex_hull
from guidefield.kept import kept_with
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.model.model import RobotModel
from guidefield.robot.model.shapes import hull, triangulation
from guidefield.scene.obstacle import Obstacle
from guidefield.scene.scene import Scene


def with_hulls(geometry: Any, group: PlanningGroup, scene: Scene) -> Any:
    """A copy of a world's geometry model in which each mesh that has a volume is its convex hull.

    Args:
        geometry: Pinocchio geometry model of the group's bodies, then the obstacles.
        group: The robot.
        scene: The obstacles.
    """
    hulls, of_links = geometry.copy(), _link_hulls(group.robot)
    index_of = {shape.name: index for index, shape in enumerate(group.robot.geometry.geometryObjects)}
    bodies = list(hulls.geometryObjects)
    for shape in bodies[: group.geometry.ngeoms]:
        shape.geometry = of_links[index_of[shape.name]] or shape.geometry
    for shape, obstacle in zip(bodies[group.geometry.ngeoms :], scene.obstacles, strict=True):
        shape.geometry = _obstacle_hull(obstacle) or shape.geometry
    return hulls


@kept_with
def _link_hulls(robot: RobotModel) -> tuple[Any | None, ...]:
    """The hull of each collision shape that is judged as a mesh; None for all others."""
    shapes = [shape.geometry for shape in robot.geometry.geometryObjects]
    return tuple(hull(shape) if isinstance(shape, coal.BVHModelBase) else None for shape in shapes)


@kept_with
def _obstacle_hull(obstacle: Obstacle) -> Any | None:
    """The hull of an obstacle that is judged as a mesh; None for a flat one, and for all others.

    A cloud of points has none: what is among its points is mostly free.
    """
    if obstacle.cloud is not None or not isinstance(obstacle.shape, coal.BVHModelBase):
        return None
    try:
        found = convex_hull(triangulation(obstacle.shape)[0])
    except ValueError:
        return None
    return convex(np.asarray(found.vertices), np.asarray(found.triangles))
