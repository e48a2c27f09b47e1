"""A world and a motion as the kernels of smallest distances read them."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin

from guidefield.collision.bodies import bodies, joint_placements
from guidefield.collision.convex_parts import PartsTable
from guidefield.collision.lanes.scene_tables import primitive_parts, surface_parts
from guidefield.collision.motion_bound import motion_bound
from guidefield.collision.obstacle_boxes import obstacle_boxes
from guidefield.collision.world import World
from guidefield.kernels.collide.parts import Parts
from guidefield.kernels.prove.tables import BezierCurve, BodyPairs, RestingObstacles, RobotBodies
from guidefield.memo import memoized
from guidefield.prove.curve import Curve
from guidefield.read_only import read_only
from guidefield.robot.group.alike import memoized_for_alike
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.joint_table import joints_of
from guidefield.scene.carried import Rows, carried
from guidefield.scene.scene import Scene

ROUNDED = 1e-5
"""What kernels give away at most by knowing the corners of hulls in float32 [m]: those within some hundred metres."""


def is_served(world: World) -> bool:
    """Whether the kernels know all bodies of a world: no obstacle moves, and no hull is too far off."""
    scene = world.scene
    if scene.moves:
        return False
    return max(_robot_rounding(world.group), _obstacle_rounding(scene)) <= ROUNDED


@memoized_for_alike
def _robot_rounding(group: PlanningGroup) -> float:
    return _rounding(robot_parts(group)[1])


@memoized
def _obstacle_rounding(scene: Scene) -> float:
    return _rounding(_obstacle_parts(scene)[1])


def _rounding(parts: Parts) -> float:
    """How far a corner of a hull may be from where it is [m]."""
    farthest = max(parts.vertices.max(initial=0.0), -parts.vertices.min(initial=0.0))
    return float(0.5 * np.sqrt(3.0) * np.spacing(np.float32(farthest)))


def prepare_obstacles(scene: Scene) -> None:
    """Make what the kernels need of those of a scene's obstacles that rest."""
    _obstacle_parts(scene.resting)


def robot_bodies(world: World) -> RobotBodies:
    """The robot of a world."""
    origin = np.array(world.group.expand(world.group.q_origin), float)
    read_only(origin)
    return _alike_bodies(world.group, world.pairs.own.tobytes())._replace(origin=origin)


@memoized_for_alike
def _alike_bodies(group: PlanningGroup, own_pairs: bytes) -> RobotBodies:
    """The robot's bodies, but for the configuration from which rotation vectors start.

    Own pairs, an array (own, 2) of int64, are those of the motion bound that is at hand already.
    """
    bound, about, (roots, parts) = motion_bound(group, own_pairs), bodies(group), robot_parts(group)
    robot = RobotBodies(
        joints=joints_of(group),
        expand=np.ascontiguousarray(group.expand_velocity, float),
        offset=np.array(group.expand_offset, float),
        origin=np.empty(0),
        half_widths=np.ascontiguousarray(bound.half_widths, float),
        alone=bound.alone.astype(float),
        together=np.ascontiguousarray(bound.together, float),
        centred=np.ascontiguousarray(bound.centred, float),
        turns=bound.turns.astype(float),
        doubled=bound.doubled,
        carriers=about.joints.astype(np.int64),
        centres=np.ascontiguousarray(about.centres, float).reshape(-1, 3),
        radii=np.array(about.radii, float),
        moved_by=_chosen(about.moved_by, np.arange(group.model.nv), group.model.nv),
        moves=np.where(about.moved_by, 1.0, -1.0),
        roots=roots,
        parts=parts,
    )
    read_only(*robot[1:-1])
    return robot


def resting_obstacles(world: World) -> RestingObstacles:
    """The obstacles of a world; see `is_served`."""
    return _resting(world.scene)


def _over(known: RestingObstacles, changed: Rows, scene: Scene) -> RestingObstacles:
    fresh = _as_rows(obstacle_boxes(scene).axes[changed.fresh])
    return _resting_with(scene, changed.carry(known.axes, fresh))


@carried(_over)
def _resting(scene: Scene) -> RestingObstacles:
    return _resting_with(scene, _as_rows(obstacle_boxes(scene).axes))


def _as_rows(axes: np.ndarray) -> np.ndarray:
    """Axes one after the other, shape (o, 9), of axes as columns, row by row."""
    return np.ascontiguousarray(axes.reshape(-1, 3, 3).transpose(0, 2, 1)).reshape(-1, 9)


def _resting_with(scene: Scene, axes: np.ndarray) -> RestingObstacles:
    boxes, (roots, parts) = obstacle_boxes(scene), _obstacle_parts(scene)
    read_only(axes)
    return RestingObstacles(axes, boxes.centres, boxes.halves, roots, parts)


def body_pairs(world: World) -> BodyPairs:
    """All pairs of a world."""
    own, (moving, obstacles) = world.pairs.own, world.pairs.mixed()
    first, second = np.concatenate([own[:, 0], moving]), np.concatenate([own[:, 1], obstacles])
    pairs = BodyPairs(first, second, *_seen_between(world.group, own.tobytes()))
    read_only(*pairs)
    return pairs


@memoized_for_alike
def _seen_between(group: PlanningGroup, own_pairs: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Of own pairs, an array (own, 2) of int64, what `BodyPairs` has: from which body each is seen.

    It is seen from the one between both from where the joints move them least at the neutral configuration; a joint's
    coordinates are all on one side of it.
    """
    own, about, bound = np.frombuffer(own_pairs, np.int64).reshape(-1, 2), bodies(group), motion_bound(group, own_pairs)
    data, nv = group.model.createData(), group.model.nv
    jacobian = pin.computeJointJacobians(group.model, data, pin.neutral(group.model)).reshape(6, -1)
    reach = bound.axis_distances(jacobian[None], about.centres_in_world(joint_placements(data))[None])[0]
    # the coordinates between the first body and the second, in order from there to here
    order = np.concatenate([np.arange(nv)[::-1], np.arange(nv)])
    between = np.concatenate([bound.first_only[:, ::-1], bound.second_only], axis=1)
    costs = np.cumsum(np.where(between, (reach[own[:, 0]] - reach[own[:, 1]])[:, order], 0.0), axis=1)
    joint_of = np.repeat(np.arange(group.model.njoints - 1), [joint.nv for joint in group.model.joints[1:]])[order]
    within = np.concatenate([[False], joint_of[1:] == joint_of[:-1], [False]])  # a joint's coordinates stay together:
    within[nv] = False  # the size of its move is counted in its first
    costs = np.where(within, np.inf, np.concatenate([np.zeros((len(own), 1)), costs], axis=1))
    at = np.argmin(costs, axis=1)
    before = np.arange(2 * nv) < at[:, None]
    found = _chosen((between & before)[:, ::-1], order[::-1], nv), _chosen(between & ~before, order, nv)
    read_only(*found)
    return found


def _chosen(mask: np.ndarray, columns: np.ndarray, width: int) -> np.ndarray:
    """The columns (k,) that a mask (n, k) has in each row, in order, and -1 behind them, shape (n, width)."""
    at = np.argsort(~mask, axis=1, kind="stable")[:, :width]
    rows: np.ndarray = np.where(np.arange(width) < mask.sum(axis=1, keepdims=True), columns[at], -1)
    return rows


def bezier_curve(curve: Curve) -> BezierCurve:
    """A motion."""
    made = BezierCurve(*(np.array(one, float, order="C") for one in (curve.times, curve.pieces)))
    read_only(*made)
    return made


@memoized_for_alike
def robot_parts(group: PlanningGroup) -> tuple[np.ndarray, Parts]:
    """Roots of the robot's bodies, shape (r,), in the frames of their joints, and their parts."""
    table = PartsTable()
    roots = [
        table.add_surface(shape.geometry, shape.placement)
        if isinstance(shape.geometry, coal.BVHModelBase)
        else table.add_shape(shape.geometry, shape.placement)
        for shape in group.geometry.geometryObjects
    ]
    return _frozen(roots), table.tables()


@memoized
def _obstacle_parts(scene: Scene) -> tuple[np.ndarray, Parts]:
    """Roots of a scene's obstacles, in the world, and their parts."""
    table, (primitive_roots, primitives) = PartsTable(), primitive_parts(scene)
    first = table.add_parts(primitives)
    of_primitives = iter((first + primitive_roots).tolist())
    roots = [
        next(of_primitives)
        if obstacle.placed
        else table.add_parts(surface_parts(obstacle))
        if obstacle.facets is not None
        else table.add_shape(obstacle.shape, obstacle.placement)
        for obstacle in scene.obstacles
    ]
    return _frozen(roots), table.tables()


def _frozen(roots: list[int]) -> np.ndarray:
    array = np.array(roots, np.int64)
    read_only(array)
    return array
