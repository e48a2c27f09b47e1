"""Problems for the planner as the benchmarks pose them: in single precision, as requests are."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from guidefield.collision.world import World
from guidefield.planner.task.problem import Goal, Problem
from guidefield.potential import Precision, RobotField
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.kinematics import Kinematics
from guidefield.scene.scene import Scene


def posed(group: PlanningGroup, scene: Scene, q_start: np.ndarray, goal: Goal, **rest: Any) -> Problem:
    """A problem, the tables of its world made anew; `rest` is what else `Problem` takes."""
    return Problem(
        group=group,
        scene=scene,
        world=World.build(group, scene),
        robot_field=RobotField(group, scene, Precision.SINGLE),
        kinematics=Kinematics(group),
        q_start=q_start,
        goal=goal,
        **rest,
    )


def listed_geometry(world: World) -> Any:
    """A world as others take it: Pinocchio's geometry model of all bodies, with all pairs."""
    geometry = world.group.geometry.copy()
    for one in world.scene.obstacles:
        geometry.addGeometryObject(pin.GeometryObject(f"obstacle/{one.name}", 0, one.placement, one.shape))
    geometry.removeAllCollisionPairs()
    for first, second in world.pairs.bodies(np.arange(len(world.pairs))).tolist():
        geometry.addCollisionPair(pin.CollisionPair(first, second))
    return geometry
