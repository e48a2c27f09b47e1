"""A world as the kernels of the certificate read it."""

from __future__ import annotations

import numpy as np

from guidefield.collision.bodies import bodies
from guidefield.collision.box_tree import CHILDREN
from guidefield.collision.hulls import link_hulls
from guidefield.collision.motion_bound import motion_bound
from guidefield.collision.obstacle_boxes import obstacle_boxes
from guidefield.collision.world import World
from guidefield.kernels.certificate.tables import CertifiedObstacles, CertifiedRobot
from guidefield.prove.cores import core_of, obstacle_cores
from guidefield.read_only import read_only
from guidefield.robot.group.alike import memoized_for_alike
from guidefield.robot.group.group import PlanningGroup
from guidefield.scene.carried import Rows, carried
from guidefield.scene.scene import Scene


def certified_robot(world: World) -> CertifiedRobot:
    """The robot of a world, and its own pairs."""
    return _robot(world.group, world.pairs.own.tobytes(), world.pairs.moving.tobytes())


def certified_obstacles(world: World) -> CertifiedObstacles:
    """The obstacles of a world, and which pairs with them are left out."""
    return _obstacles(world.scene, world.pairs.left_out.tobytes())


@memoized_for_alike
def _robot(group: PlanningGroup, own_pairs: bytes, moving: bytes) -> CertifiedRobot:
    """A robot with its own pairs and the bodies that are tested against obstacles, both arrays of int64."""
    about, bound = bodies(group), motion_bound(group, own_pairs)
    hulls = zip(group.geometry.geometryObjects, link_hulls(group), strict=True)
    shapes = [(shape.placement, core_of(hull or shape.geometry)) for shape, hull in hulls]
    corners = [core.corners @ place.rotation.T + place.translation for place, core in shapes]
    robot = CertifiedRobot(
        carriers=about.joints.astype(np.int64),
        centres=_rows(about.centres, 3),
        radii=_rows(about.radii),
        part_centres=np.array(about.part_centres, float, order="C"),
        part_radii=_rows(about.part_radii),
        moved_by=np.array(about.moved_by, order="C"),
        turns=about.turns[None].copy(),
        alone=bound.alone[None].copy(),
        half_widths=_rows(bound.half_widths),
        together=_rows(bound.together),
        centred=_rows(bound.centred),
        doubled=_rows(bound.doubled),
        moving=np.frombuffer(moving, np.int64),
        own=np.frombuffer(own_pairs, np.int64).reshape(-1, 2),
        apart_from=bound.apart_from.astype(np.int64),
        corners=_rows(np.concatenate([np.empty((0, 3)), *corners]), 3),
        corners_from=np.cumsum([0, *map(len, corners)]),
        disc_axes=_rows(np.array([place.rotation[:, 2] for place, _ in shapes]), 3),
        discs=_rows(np.array([core.disc for _, core in shapes])),
        rounded=_rows(np.array([core.rounded for _, core in shapes])),
        filled=np.array([core.filled for _, core in shapes], np.int64),
    )
    read_only(*robot)
    return robot


def _over(_: CertifiedObstacles, _rows: Rows, scene: Scene, left_out: bytes) -> CertifiedObstacles:
    return _made(scene, left_out)


@carried(_over)
def _obstacles(scene: Scene, left_out: bytes) -> CertifiedObstacles:
    """The obstacles of a scene, and the pairs that are left out, an array of int64; their arrays are those of boxes."""
    return _made(scene, left_out)


def _made(scene: Scene, left_out: bytes) -> CertifiedObstacles:
    boxes, cores = obstacle_boxes(scene), obstacle_cores(scene)
    order = boxes.tree.order
    obstacles = CertifiedObstacles(
        axes=boxes.axes,
        middles=boxes.centres,
        halves=boxes.halves,
        cores=cores.halves,
        discs=cores.discs,
        rounded=cores.rounded,
        filled=cores.filled,
        nodes=boxes.tree.nodes,
        levels=boxes.tree.firsts,
        children=CHILDREN,
        order=boxes.bounded[order] if len(boxes.endless) else order,
        endless=boxes.endless,
        left_out=np.frombuffer(left_out, np.int64),
    )
    read_only(*obstacles)
    return obstacles


def _rows(array: np.ndarray, width: int | None = None) -> np.ndarray:
    """A copy in double precision, of rows of so many numbers."""
    copied = np.array(array, float, order="C")
    return copied if width is None else copied.reshape(-1, width)
