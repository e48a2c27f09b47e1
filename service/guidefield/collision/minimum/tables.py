"""A world and a motion as the kernels of smallest distances read them."""

from __future__ import annotations

import coal
import numpy as np

from guidefield.collision.convex_parts import PartsTable
from guidefield.collision.lanes.scene_tables import surface_parts
from guidefield.collision.minimum.curve import Curve
from guidefield.collision.world import World
from guidefield.kept import kept_with
from guidefield.kernels.collide.parts import Parts
from guidefield.kernels.minimum.tables import BezierCurve, BodyPairs, RestingObstacles, RobotBodies
from guidefield.read_only import read_only
from guidefield.robot.group.alike import kept_with_alike
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.joint_table import joints_of
from guidefield.scene.scene import Scene

ROUNDED = 1e-5
"""What kernels give away at most by knowing the corners of hulls in float32 [m]: those within some hundred metres."""


def is_served(world: World) -> bool:
    """Whether the kernels know all bodies of a world: no obstacle moves or is a cloud, and no hull is too far off."""
    scene = world.scene
    if not _is_known(scene):
        return False
    return max(_robot_rounding(world.group), _obstacle_rounding(scene)) <= ROUNDED


def _is_known(scene: Scene) -> bool:
    """Whether all obstacles of a scene are of a kind that the kernels know."""
    return not scene.moves and all(obstacle.cloud is None for obstacle in scene.obstacles)


@kept_with_alike
def _robot_rounding(group: PlanningGroup) -> float:
    return _rounding(_robot_parts(group)[1])


@kept_with
def _obstacle_rounding(scene: Scene) -> float:
    return _rounding(_obstacle_parts(scene)[1])


def _rounding(parts: Parts) -> float:
    """How far a corner of a hull may be from where it is [m]."""
    farthest = max(parts.vertices.max(initial=0.0), -parts.vertices.min(initial=0.0))
    return float(0.5 * np.sqrt(3.0) * np.spacing(np.float32(farthest)))


def prepare_obstacles(scene: Scene) -> None:
    """Make what the kernels need of a scene's obstacles, if they know their kinds."""
    if _is_known(scene):
        _obstacle_parts(scene)


def robot_bodies(world: World) -> RobotBodies:
    """The robot of a world."""
    group, bound, bodies = world.group, world.motion_bound, world.bodies
    roots, parts = _robot_parts(group)
    robot = RobotBodies(
        joints=joints_of(group),
        expand=np.ascontiguousarray(group.expand_velocity, float),
        offset=np.array(group.expand_offset, float),
        origin=np.array(group.expand(group.q_origin), float),
        half_widths=np.ascontiguousarray(bound.half_widths, float),
        together=np.ascontiguousarray(bound.together, float),
        centred=np.ascontiguousarray(bound.centred, float),
        turns=bound.turns.astype(float),
        doubled=bound.doubled,
        carriers=bodies.joints.astype(np.int64),
        centres=np.ascontiguousarray(bodies.centres, float).reshape(-1, 3),
        radii=np.array(bodies.radii, float),
        moved_by=bodies.moved_by.astype(float),
        roots=roots,
        parts=parts,
    )
    read_only(*robot[1:-1])
    return robot


def resting_obstacles(world: World) -> RestingObstacles:
    """The obstacles of a world; see `is_served`."""
    roots, parts = _obstacle_parts(world.scene)
    axes, centres, halves = (np.array(one, order="C") for one in world.boxes.along_own_axes)
    rows = np.ascontiguousarray(axes.transpose(0, 2, 1)).reshape(len(axes), 9)
    read_only(rows, centres, halves)
    return RestingObstacles(rows, centres, halves, roots, parts)


def body_pairs(world: World) -> BodyPairs:
    """All pairs of a world."""
    bound, every = world.motion_bound, np.arange(len(world.pairs))
    first, second = world.pairs.bodies(every).T
    second = np.where(every < world.pairs.n_self, second, second - world.pairs.links)
    masks = bound.first_only.astype(float), bound.second_only.astype(float)
    pairs = BodyPairs(np.ascontiguousarray(first), second, *masks)
    read_only(*pairs)
    return pairs


def bezier_curve(curve: Curve) -> BezierCurve:
    """A motion."""
    arrays = (curve.times, curve.pieces, curve.velocities, curve.accelerations)
    made = BezierCurve(*(np.array(one, float, order="C") for one in arrays))
    read_only(*made)
    return made


@kept_with_alike
def _robot_parts(group: PlanningGroup) -> tuple[np.ndarray, Parts]:
    """Roots of the robot's bodies, in the frames of their joints, and their parts."""
    table = PartsTable()
    roots = [
        table.add_surface(shape.geometry, shape.placement)
        if isinstance(shape.geometry, coal.BVHModelBase)
        else table.add_shape(shape.geometry, shape.placement)
        for shape in group.geometry.geometryObjects
    ]
    return _frozen(roots), table.tables()


@kept_with
def _obstacle_parts(scene: Scene) -> tuple[np.ndarray, Parts]:
    """Roots of a scene's obstacles, in the world, and their parts."""
    table = PartsTable()
    roots = [
        table.add_parts(surface_parts(obstacle))
        if obstacle.facets is not None
        else table.add_shape(obstacle.shape, obstacle.placement)
        for obstacle in scene.obstacles
    ]
    return _frozen(roots), table.tables()


def _frozen(roots: list[int]) -> np.ndarray:
    array = np.array(roots, np.int64)
    read_only(array)
    return array
