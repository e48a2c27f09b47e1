"""Hulls in the place of meshes: what keeps apart from a hull keeps apart from the mesh in it, and is sooner tested."""

from __future__ import annotations

from typing import Any

import coal
import numpy as np

from guidefield.geometry.convex import convex, convex_hull
from guidefield.memo import memoized
from guidefield.robot.group.alike import memoized_for_alike
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.model.model import RobotModel
from guidefield.robot.model.shapes import hull
from guidefield.scene.obstacle import Obstacle

MOST_TRIANGLES = 20_000
"""An obstacle of more has no hull."""


@memoized_for_alike
def link_hulls(group: PlanningGroup) -> tuple[Any | None, ...]:
    """The hull of each of a group's bodies that is judged as a mesh; None for all others."""
    of_robot = hulls_of(group.robot)
    index_of = {shape.name: index for index, shape in enumerate(group.robot.geometry.geometryObjects)}
    return tuple(of_robot[index_of[shape.name]] for shape in group.geometry.geometryObjects)


@memoized
def hulls_of(robot: RobotModel) -> tuple[Any | None, ...]:
    """The hull of each collision shape that is judged as a mesh; None for all others."""
    shapes = [shape.geometry for shape in robot.geometry.geometryObjects]
    return tuple(hull(shape) if isinstance(shape, coal.BVHModelBase) else None for shape in shapes)


@memoized
def obstacle_hull(obstacle: Obstacle) -> Any | None:
    """The hull of an obstacle that is judged as a mesh; None for a flat one, and for all others.

    A cloud of points has none: what is among its points is mostly free. So is what is within the hull of a mesh of very
    many triangles, which takes long to find.
    """
    if obstacle.cloud is not None or not 0 < obstacle.faces <= MOST_TRIANGLES:
        return None
    try:
        found = convex_hull(obstacle.recipe.surface(obstacle.message)[0])
    except ValueError:
        return None
    return convex(np.asarray(found.vertices), np.asarray(found.triangles))
