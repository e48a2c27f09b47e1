"""Tables of a world and a motion for the search's kernels: robot, obstacles, movers, pairs, and the Bezier curve.

Columns are those of kernels/prove. Everything proved rests on the errors here being large enough: `ARITHMETIC`, which
docs/certificate.md states, `rounding_of`, and the speeds of obstacles that move. A larger `ROUNDED` requires
more distance, and handlers/agreement.py lets pass contradictions up to twice that.
"""

from __future__ import annotations

from typing import NamedTuple

import msgspec
import numpy as np
import pinocchio as pin

from guidefield.collision.batch.scene_tables import balls_of_cloud, batch_scene
from guidefield.collision.bodies import bodies, joint_placements, motion_bound
from guidefield.collision.obstacle_boxes import obstacle_boxes
from guidefield.collision.part_tables import BodyParts, PartsTable, robot_parts
from guidefield.collision.world import World
from guidefield.kernels.collide.parts import Parts
from guidefield.kernels.prove.tables import BezierCurve, BodyPairs, MovingObstacles, ObstacleBodies, RobotBodies
from guidefield.memo import memoized
from guidefield.messages import scene as messages
from guidefield.prove.curve import Curve
from guidefield.read_only import read_only
from guidefield.robot.group.group import PlanningGroup, memoized_for_alike
from guidefield.robot.group.kinematics import joints_of
from guidefield.robot.model.joints import LocalPoint
from guidefield.scene.movers import motion_of, movers
from guidefield.scene.obstacle_message import points_in
from guidefield.scene.scene import Scene, build, unplaced

ROUNDED = 1e-5  # obstacles whose corners single precision rounds by more are seen from an anchor [m]
ARITHMETIC = 2e-9  # error of double precision: this times 1 m plus the distance from the origin


class WorldTables(NamedTuple):
    """The tables of a world that a search reads."""

    robot: RobotBodies
    obstacles: ObstacleBodies
    movers: MovingObstacles
    pairs: BodyPairs
    error: float  # by how much a proved distance may be too large, see `arithmetic_error` [m]


def world_tables(world: World, *, in_time: bool) -> WorldTables:
    """Build the tables of a world, with obstacles that move, or all at rest where they are at first."""
    timed = in_time and world.scene.moves
    obstacles = obstacle_bodies(world.scene, timed=timed)
    movers = moving_placements(world.scene) if timed else NOTHING_MOVES
    return WorldTables(robot_bodies(world), obstacles, movers, body_pairs(world), arithmetic_error(world))


def arithmetic_error(world: World) -> float:
    """Return by how much a proved distance may be too large [m]: the corners of hulls are in single precision."""
    far = max(_robot_extent(world.group), _obstacle_extent(world.scene))
    return _robot_rounding(world.group) + _obstacle_rounding(world.scene) + ARITHMETIC * (1.0 + far)


@memoized_for_alike
def _robot_rounding(group: PlanningGroup) -> float:
    return rounding_of(robot_parts(group).parts)


@memoized
def _obstacle_rounding(scene: Scene) -> float:
    return rounding_of(_obstacle_parts(scene).parts)


@memoized_for_alike
def _robot_extent(group: PlanningGroup) -> float:
    about = bodies(group)
    return float(np.abs(about.centres).max(initial=0.0) + np.max(about.radii, initial=0.0))


@memoized
def _obstacle_extent(scene: Scene) -> float:
    boxes = obstacle_boxes(scene).tree.boxes
    return float(np.abs(boxes).max(initial=0.0))


def rounding_of(parts: Parts) -> float:
    """Return how far single precision may put a corner of a hull from its place [m]."""
    farthest = max(parts.vertices.max(initial=0.0), -parts.vertices.min(initial=0.0))
    return float(0.5 * np.sqrt(3.0) * np.spacing(np.float32(farthest)))


def prepare_obstacles(scene: Scene) -> None:
    """Build the convex parts of a scene's obstacles at rest."""
    _obstacle_parts(scene.resting)


def robot_bodies(world: World) -> RobotBodies:
    """Build the tables of the robot of a world."""
    origin = np.array(world.group.expand(world.group.q_origin), float)
    read_only(origin)
    return _alike_bodies(world.group, world.pairs.own.tobytes())._replace(origin=origin)


@memoized_for_alike
def _alike_bodies(group: PlanningGroup, own_pairs: bytes) -> RobotBodies:
    """Build the robot's bodies, but for the configuration from which rotation vectors start.

    Own pairs are the bytes of an array (own, 2) of int64, as `motion_bound` takes them.
    """
    bound, about, (roots, parts, anchor) = motion_bound(group, own_pairs), bodies(group), robot_parts(group)
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
        parent_joints=about.joints,
        centres=about.centres,
        radii=about.radii,
        moved_by=_choose(about.moved_by, np.arange(group.model.nv), group.model.nv),
        moves=np.where(about.moved_by, 1.0, -1.0),
        roots=roots,
        parts=parts,
        anchor=anchor,
    )
    read_only(*robot[1:-2])
    return robot


@memoized
def obstacle_bodies(scene: Scene, *, timed: bool) -> ObstacleBodies:
    """Build the obstacles of a scene where they are at first; if `timed`, moving ones are kept apart."""
    boxes, (roots, parts, anchor) = obstacle_boxes(scene).tables, _obstacle_parts(scene)
    movers_of = np.full(len(roots), -1)
    if timed and scene.moves:
        moving = movers(scene).indices
        movers_of[moving] = np.arange(len(moving))
        rest, resting = np.flatnonzero(movers_of < 0), obstacle_boxes(scene.resting).tables
        order, apart = rest[resting.order], np.union1d(rest[resting.apart], moving)
        read_only(order, apart)
        boxes = boxes._replace(nodes=resting.nodes, levels=resting.levels, order=order, apart=apart)
    read_only(movers_of)
    return ObstacleBodies(boxes, roots, parts, anchor, movers_of)


@memoized
def moving_placements(scene: Scene) -> MovingObstacles:
    """Build the motions of a scene's moving obstacles; speeds of half-spaces are 0 here."""
    known = movers(scene)
    motions = [motion_of(one) for one in known.obstacles]
    poses, twists = list[np.ndarray](), list[np.ndarray]()
    for motion in motions:
        back = motion.placements[0].inverse()
        poses += [(place * back).homogeneous[:3].ravel() for place in motion.placements]
        twists += [
            place.act(pin.Motion(twist)).vector for place, twist in zip(motion.placements, motion.twists, strict=False)
        ]
        twists.append(np.zeros(6))
    made = MovingObstacles(
        begins=np.cumsum([0, *(len(motion.times) for motion in motions)]),
        times=np.concatenate([np.empty(0), *(motion.times for motion in motions)]),
        poses=np.array(poses, float).reshape(-1, 12),
        twists=np.array(twists, float).reshape(-1, 6),
        speeds=np.array([speed for speeds in known.speeds for speed in (*speeds, 0.0)], float),
        endless=np.array([int(ball is None) for ball in known.balls], np.int64),
        margins=np.zeros(len(motions)),
        growths=np.zeros(len(motions)),
        since=np.zeros(len(motions)),
    )
    read_only(*made)
    return made


def with_passing_speeds(world: World, curve: Curve, made: MovingObstacles) -> MovingObstacles:
    """Set the speeds of moving half-spaces: the largest at which they pass the robot along a motion."""
    if not made.endless.any():
        return made
    about, speeds, known = robot_ball(world, *curve.box), made.speeds.copy(), movers(world.scene)
    for index in np.flatnonzero(made.endless).tolist():
        begin, end = made.begins[index], made.begins[index + 1]
        speeds[begin : end - 1] = motion_of(known.obstacles[index]).passing(*about)[1:-1]
    read_only(speeds)
    return made._replace(speeds=speeds)


def robot_ball(world: World, low: LocalPoint, high: LocalPoint) -> tuple[np.ndarray, float]:
    """Return a ball about the bodies that are tested against obstacles, anywhere between corners (nv,).

    Centre (3,) and radius [m, world]. The robot is placed anew.
    """
    group, about, moving = world.group, world.bodies, world.pairs.moving
    q = group.expand_from_local(0.5 * (low + high))
    jacobian = pin.computeJointJacobians(world.model, world.data, q).reshape(6, -1)
    centres = about.centres_in_world(world.joint_placements[None])
    _, reach = world.motion_bound.at(jacobian[None], centres, 0.5 * (high - low)[None])
    own = centres[0, moving]
    centre = own.mean(axis=0)
    away = np.linalg.norm(own - centre, axis=1) + about.radii[moving] + reach[0, moving]
    return centre, float(away.max())


NOTHING_MOVES = MovingObstacles(
    np.zeros(1, np.int64), np.empty(0), np.empty((0, 12)), np.empty((0, 6)), np.empty(0), np.empty(0, np.int64),
    np.empty(0), np.empty(0), np.empty(0),
)  # fmt: skip
read_only(*NOTHING_MOVES)


def body_pairs(world: World) -> BodyPairs:
    """Build the tables of the pairs of a world."""
    return BodyPairs(*world.pairs.table, *_find_views(world.group, world.pairs.own.tobytes()))


def index_of_pair(world: World, pair: int) -> int:
    """Return the index among a world's pairs of a pair as kernels number it, who count allowed pairs too."""
    mixed = pair - world.pairs.n_self
    return pair if mixed < 0 else pair - int(np.searchsorted(world.pairs.left_out, mixed))


@memoized_for_alike
def _find_views(group: PlanningGroup, own_pairs: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Choose for own pairs, bytes of (own, 2) int64, the body between both in whose frame their motion is bounded.

    It is the one from where the joints move both least at the neutral configuration; a joint's coordinates are all on
    one side of it. The arrays are those of `BodyPairs`.
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
    found = _choose((between & before)[:, ::-1], order[::-1], nv), _choose(between & ~before, order, nv)
    read_only(*found)
    return found


def _choose(mask: np.ndarray, columns: np.ndarray, width: int) -> np.ndarray:
    """Return the columns (k,) that a mask (n, k) chooses in each row, in order, and -1 behind them, (n, width)."""
    at = np.argsort(~mask, axis=1, kind="stable")[:, :width]
    rows: np.ndarray = np.where(np.arange(width) < mask.sum(axis=1, keepdims=True), columns[at], -1)
    return rows


def bezier_curve(curve: Curve) -> BezierCurve:
    """Lay out a motion; its parameter is the time, or the index of a piece where pieces take no time."""
    pieces, clock = np.array(curve.pieces, float, order="C"), np.array(curve.times, float)
    if pieces.shape[1] == 1:
        pieces = np.repeat(pieces, 2, axis=1)
    tube = np.zeros(pieces[:, 0].shape) if curve.tube is None else np.array(curve.tube, float, order="C")
    parameters = clock if (np.diff(clock) > 0.0).all() else np.arange(len(clock), dtype=float)
    made = BezierCurve(parameters, clock, pieces, tube)
    read_only(*made)
    return made


@memoized
def _obstacle_parts(scene: Scene) -> BodyParts:
    """Build the convex parts of a scene's obstacles, relative to the origin, or to a point among them if it is far."""
    made = parts_in_world(scene)
    if rounding_of(made.parts) <= ROUNDED:
        return made
    # in single precision coordinates far away are coarse
    boxes = obstacle_boxes(scene).tree.boxes
    anchor = np.median(0.5 * (boxes[:, :3] + boxes[:, 3:]), axis=0)
    shifted = [_shift(obstacle.message, anchor) for obstacle in scene.obstacles]
    read_only(anchor)
    return parts_in_world(build(messages.Scene(name=scene.message.name, obstacles=shifted)))._replace(anchor=anchor)


def parts_in_world(scene: Scene) -> BodyParts:
    """Build the convex parts of a scene's obstacles, relative to the world's origin."""
    known = batch_scene(scene)
    roots, parts = known.roots, known.tables[1]
    clouds = [index for index in unplaced(scene) if scene.obstacles[index].cloud is not None]
    if clouds:
        table, roots = PartsTable(), roots.copy()
        table.add_parts(parts)
        roots[clouds] = [table.add_parts(balls_of_cloud(scene.obstacles[index])) for index in clouds]
        parts = table.tables()
        read_only(roots)
    return BodyParts(roots, parts, _ORIGIN)


def _shift(message: messages.Obstacle, anchor: np.ndarray) -> messages.Obstacle:
    """Return an obstacle at rest relative to an anchor (3,) [m]; a half-space, whose numbers are exact, as it is."""
    if isinstance(message, messages.HalfSpace):
        return msgspec.structs.replace(message, trajectory=None)
    if isinstance(message, messages.Polygon):
        corners = (np.array(message.vertices) - anchor).tolist()
        return msgspec.structs.replace(message, vertices=[*map(tuple, corners)], trajectory=None)
    if isinstance(message, messages.PointCloud):
        return msgspec.structs.replace(message, points=(points_in(message.points) - anchor).tolist(), trajectory=None)
    x, y, z = (np.array(message.position) - anchor).tolist()
    return msgspec.structs.replace(message, position=(x, y, z), trajectory=None)


_ORIGIN = np.zeros(3)
read_only(_ORIGIN)
