"""A robot among obstacles as the kernel reads it that finds which pairs may touch."""

from __future__ import annotations

import numpy as np

from guidefield.collision.bodies import bodies
from guidefield.collision.box_tree import CHILDREN
from guidefield.collision.obstacle_boxes import obstacle_boxes
from guidefield.collision.pairs import Pairs
from guidefield.kernels.collide.near_pairs import BalledRobot, BoxedObstacles
from guidefield.read_only import read_only
from guidefield.robot.group.alike import memoized_for_alike
from guidefield.robot.group.group import PlanningGroup
from guidefield.scene.scene import Scene


def balled_robot(group: PlanningGroup, pairs: Pairs) -> BalledRobot:
    """Balls about a robot's bodies, and its own pairs."""
    return _robot(group, pairs.own.tobytes(), pairs.moving.tobytes())


def boxed_obstacles(scene: Scene, pairs: Pairs) -> BoxedObstacles:
    """Boxes about a scene's obstacles, and which pairs with them are left out."""
    boxes = obstacle_boxes(scene)
    order = boxes.tree.order
    obstacles = BoxedObstacles(
        axes=boxes.axes,
        middles=boxes.centres,
        halves=boxes.halves,
        nodes=boxes.tree.nodes,
        levels=boxes.tree.firsts,
        children=CHILDREN,
        order=boxes.bounded[order] if len(boxes.endless) else order,
        endless=boxes.endless,
        left_out=pairs.left_out.astype(np.int64),
    )
    read_only(*obstacles)
    return obstacles


@memoized_for_alike
def _robot(group: PlanningGroup, own_pairs: bytes, moving: bytes) -> BalledRobot:
    """A robot with its own pairs and the bodies that are tested against obstacles, both arrays of int64."""
    about = bodies(group)
    robot = BalledRobot(
        carriers=about.joints.astype(np.int64),
        centres=np.array(about.centres, float, order="C").reshape(-1, 3),
        radii=np.array(about.radii, float),
        part_centres=np.array(about.part_centres, float, order="C"),
        part_radii=np.array(about.part_radii, float),
        own=np.frombuffer(own_pairs, np.int64).reshape(-1, 2),
        moving=np.frombuffer(moving, np.int64),
    )
    read_only(*robot)
    return robot
