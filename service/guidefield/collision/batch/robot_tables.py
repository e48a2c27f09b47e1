"""A planning group as tables for SIMD batches: its joints, hulls, pieces and balls of its shapes, and pairs of links.

Columns and order are those of kernels/collide and kernels/kinematics/batch_forward_kinematics.py. Joint frames are
turned so that z is the axis: everything in a joint's frame has to be turned with it. Balls, hulls and pieces must
contain the shapes, else contacts pass for free; inscribed balls and points must be inside, else the free for contacts.
Numbers of points and planes are time alone.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from guidefield.collision.batch.cell_grids import batch_grids
from guidefield.collision.part_tables import BodyParts, PartsTable, robot_parts
from guidefield.geometry.convex import hull_planes, polytope_about
from guidefield.geometry.decomposition import ConvexPart, Decomposition
from guidefield.geometry.surfaces import furthest, spread_and_axes, spread_directions, transform_points
from guidefield.kernels.collide.batch_collision import FRACTIONS
from guidefield.kernels.collide.layout import BAND, GRID_SIDES, BatchBodies
from guidefield.kernels.collide.parts import SURFACE, Parts
from guidefield.kernels.cover.cut_halves import not_beyond
from guidefield.kernels.cover.enclosing_ball import ball_around_balls
from guidefield.kernels.kinematics import forward_kinematics
from guidefield.kernels.kinematics.batch_forward_kinematics import (
    BALL,
    FLOATING,
    GROUNDED,
    JOINT,
    PARALLEL,
    PLAIN,
    PLANAR,
    QUATERNION,
    SLIDING,
    SQUARE,
    TURNING,
    BatchJoints,
)
from guidefield.memo import SharedAnswer, memoized_by_value
from guidefield.read_only import read_only
from guidefield.robot.group.group import PlanningGroup, memoized_for_alike
from guidefield.robot.group.kinematics import joints_of
from guidefield.robot.link_bounds import convex_parts, coverage
from guidefield.robot.model.collision_shapes import hull_vertices, triangulation
from guidefield.robot.model.model import joint_table

KINDS = np.empty(6, np.int64)  # the SIMD kernels' kind of each kind of joint in `forward_kinematics`
KINDS[[forward_kinematics.REVOLUTE, forward_kinematics.CONTINUOUS]] = TURNING
KINDS[forward_kinematics.PRISMATIC] = SLIDING
KINDS[forward_kinematics.PLANAR] = PLANAR
KINDS[forward_kinematics.SPHERICAL] = BALL
KINDS[forward_kinematics.FLOATING] = FLOATING

SURFACE_POINTS = 24  # points of its surface that stand for an open mesh's inside, which it doesn't have
SPREAD_POINTS = 48  # most points that stand for the surface of a piece

MOST_PLANES = 64
"""A triangle belongs to a piece if it isn't beyond a plane of a piece's largest faces, of which this is the most."""

ROUNDING = 1e-6  # by how much a triangle is beyond a piece's plane to be left out [m]: may grow, not shrink
_QUARTER_TURN = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # the rotation about x by a right angle
_SAME_DIRECTION = 3e-8  # directions that differ less are the same in float32


@dataclass(frozen=True, eq=False)
class LinkTables(SharedAnswer):
    """The collision shapes of a group as the kernels read them, whichever pairs of them must not touch."""

    joints: BatchJoints  # its joints; rotation vectors start from the identity, see `turn_from`
    parts: Parts  # hulls of the shapes and of their pieces, in the turned frames of joints
    roots: np.ndarray  # the node of each shape's hull, shape (n,)
    pieces: list[np.ndarray]  # nodes of each shape's nearly convex pieces, which together contain it
    surfaces: BodyParts  # the shapes themselves, in the frames of joints
    surface_frames: np.ndarray  # where those frames are in the turned ones, shape (n, 12)
    # bounding spheres, inscribed ones, groups of the first, one about each shape; arrays (k, 4) [m]
    balls: tuple[list[np.ndarray], list[np.ndarray], list[np.ndarray], list[np.ndarray]]
    sizes: list[np.ndarray]  # how many bounding spheres each group has


@memoized_for_alike
def link_tables(group: PlanningGroup) -> LinkTables:
    """Build the tables of a group's collision shapes.

    Raises:
        UnsupportedShape: if a shape is of a kind that the kernels don't know.
    """
    turns, surfaces = _turns(group.model), robot_parts(group)
    table, roots, pieces, frames = PartsTable(), [], [], []
    covers, inners, grouped, bounds, sizes = [], [], [], [], []
    shapes, balls = group.geometry.geometryObjects, coverage(group.robot).shapes
    for shape, ball, cut in zip(shapes, balls, convex_parts(group.robot), strict=True):
        turned = pin.SE3(turns[shape.parentJoint].T, np.zeros(3))
        placement = turned * shape.placement
        root, nodes = _add_hulls(table, shape.geometry, cut, placement)
        roots.append(root)
        pieces.append(nodes)
        anchor = surfaces.anchor if shape.parentJoint == 0 else np.zeros(3)
        frames.append(np.c_[turned.rotation, anchor].ravel())
        covers.append(_place_balls(placement, ball.cover.spheres))
        open_mesh = len(ball.inner) == 0 and isinstance(shape.geometry, coal.BVHModelBase)
        inners.append(_place_balls(placement, _surface_points(shape.geometry) if open_mesh else ball.inner))
        grouped.append(_place_balls(placement, ball.cover.groups))
        sizes.append(np.diff(ball.cover.first))
        bounds.append(_place_balls(placement, ball.cover.bound[None]))
    joints, parts, all_roots = _joints(group, turns), table.tables(), np.array(roots, np.int64)
    placed, balls_of = np.array(frames).reshape(-1, 12), (covers, inners, grouped, bounds)
    return LinkTables(joints, parts, all_roots, pieces, surfaces, placed, balls_of, sizes)


def _add_hulls(table: PartsTable, shape: Any, cut: Decomposition | None, placement: pin.SE3) -> tuple[int, np.ndarray]:
    """Add the hull of a shape, and those of its pieces, each with points of its surface behind it.

    Returns:
        The node of the hull, and the nodes of the pieces, shape (k,): that of the hull if there is but one.
    """
    if not isinstance(shape, coal.BVHModelBase):
        root = table.add_shape(shape, placement)
        return root, np.array([root])
    if cut is None:
        hull = hull_vertices(shape)
        about = _box_about(shape.vertices()) if hull is None else polytope_about(hull)
        root = table.add_hull(transform_points(placement, about))
        return root, np.array([root])
    surface = triangulation(shape)
    found = [(part, _surface_of(*surface, part)) for part in cut.parts]
    found = [(part, points) for part, points in found if len(points)]  # a part of the inside only has no surface
    hulls = [part for part, _ in found] if len(found) == 1 else [cut.hull, *(part for part, _ in found)]
    nodes = []
    for index, part in enumerate(hulls):
        nodes.append(table.add_hull(transform_points(placement, polytope_about(np.asarray(part.hull.vertices)))))
        if index > 0:
            table.add_hull(transform_points(placement, found[index - 1][1]), SURFACE)
    return nodes[0], np.array(nodes[len(nodes) > 1 :])


def _box_about(points: np.ndarray) -> np.ndarray:
    """Return the corners of the box about points (n, 3) along their principal axes, shape (8, 3) [m]."""
    centre = points.mean(axis=0)
    _, axes = spread_and_axes(points - centre)
    along = (points - centre) @ axes.T
    ends = np.array([along.min(axis=0), along.max(axis=0)])
    found: np.ndarray = centre + np.array(list(itertools.product(*ends.T))) @ axes
    return found


def _surface_of(vertices: np.ndarray, faces: np.ndarray, part: ConvexPart) -> np.ndarray:
    """Return corners of a mesh's triangles in a part, those farthest along directions spread over all, (k, 3) [m]."""
    inside = np.empty(len(faces), np.bool_)
    not_beyond(vertices[faces].reshape(-1, 3), hull_planes(part.hull, MOST_PLANES), ROUNDING, inside)
    corners: np.ndarray = vertices[np.unique(faces[inside])]
    if not len(corners):
        return corners
    directions = np.concatenate([spread_directions(SPREAD_POINTS - 6), np.eye(3), -np.eye(3)])
    directions /= np.maximum(np.ptp(corners, axis=0), 1e-9)
    found: np.ndarray = corners[np.unique(furthest(corners, directions))]
    return found


@dataclass(frozen=True, eq=False)
class BatchRobot:
    """A robot for SIMD batches: joints with one axis turn about z or slide along it, bodies are in their frames."""

    links: LinkTables  # its collision shapes, shared by robots with other pairs
    joints: BatchJoints
    bodies: BatchBodies
    pieces_paired: int  # how many pairs of pieces there are
    fractions: np.ndarray  # as `BatchWorld` has them

    @property
    def parts(self) -> Parts:
        """Hulls of the shapes and of their pieces."""
        return self.links.parts

    @property
    def surfaces(self) -> Parts:
        """The shapes themselves."""
        return self.links.surfaces.parts


def batch_robot(group: PlanningGroup, pairs: np.ndarray) -> BatchRobot:
    """Build the tables of a group and the pairs (p, 2) of its shapes' indices that must not touch each other.

    Raises:
        UnsupportedShape: if a shape is of a kind that the kernels don't know.
    """
    links = link_tables(group)
    pieces, (covers, inners, grouped, bounds) = links.pieces, links.balls
    joints = np.array([shape.parentJoint for shape in group.geometry.geometryObjects], np.int64)
    link_joints = np.unique(joints)[::-1]
    members = [np.flatnonzero(joints == joint) for joint in link_joints]
    link_pairs, ordered = _find_link_pairs(pairs, np.searchsorted(-link_joints, -joints))
    counts = np.array([len(nodes) for nodes in pieces], np.int64)
    products = counts[ordered].prod(axis=1)
    places = _offsets_of(products + (products > 1))
    whole = [np.concatenate([covers[body] for body in bodies]) for bodies in members]
    several = [bool((products[first:last] > 1).any()) for first, last in link_pairs[:, 2:].tolist()]
    most = np.where(several, GRID_SIDES, GRID_SIDES - 1)
    grids = batch_grids(links.joints, link_pairs, link_joints, whole, np.column_stack([group.lower, group.upper]), most)
    nodes = np.concatenate([np.empty(0, np.int64), *pieces])
    bodies = BatchBodies(
        size=len(joints),
        n_links=len(link_joints),
        moving=int(np.count_nonzero(link_joints)),
        n_link_pairs=len(link_pairs),
        n_cells=len(grids.cells),
        joints=joints,
        link_joints=link_joints.astype(np.int64),
        members=_offsets(members),
        order=np.concatenate([np.empty(0, np.int64), *members]),
        groups=_offsets(grouped),
        covers=_offsets_of(np.concatenate([np.empty(0, np.int64), *links.sizes])),
        inners=_offsets(inners),
        roots=links.roots,
        surface_roots=links.surfaces.roots,
        pieces=_offsets(pieces),
        piece_roots=nodes,
        link_pairs=link_pairs.ravel(),
        pairs=np.column_stack([ordered, places[:-1]]).ravel(),
        around=_balls([_ball_about(np.concatenate([bounds[body] for body in bodies])) for bodies in members]),
        bounds=_balls(bounds),
        piece_bounds=links.parts.balls.reshape(-1, 4)[nodes].astype(np.float32).ravel(),
        surface_frames=links.surface_frames.ravel(),
        grouped=_balls(grouped),
        cover=_balls(covers),
        inner=_balls(inners),
        **grids._asdict(),
    )
    for array in bodies[5:-2]:
        array.setflags(write=False)
    fractions = np.concatenate([FRACTIONS, 1.0 / group.sizes]).astype(np.float32)
    read_only(fractions)
    return BatchRobot(links, links.joints, bodies, int(places[-1]), fractions)


def _surface_points(shape: Any) -> np.ndarray:
    """Return balls (n, 4) in place of inscribed ones for an open mesh: points of its surface, far from each other.

    An obstacle that contains one touches the mesh; the radius takes back what the kernels take off for rounding.
    """
    vertices, faces = triangulation(shape)
    return _spread_points(vertices.tobytes(), faces.tobytes())


@memoized_by_value(64)
def _spread_points(vertices_bytes: bytes, faces_bytes: bytes) -> np.ndarray:
    vertices = np.frombuffer(vertices_bytes).reshape(-1, 3)
    faces = np.frombuffer(faces_bytes, np.int64).reshape(-1, 3)
    candidates = np.concatenate([vertices[np.unique(faces)], vertices[faces].mean(axis=1)])
    chosen, away = [], np.linalg.norm(candidates - candidates.mean(axis=0), axis=1)
    for _ in range(min(SURFACE_POINTS, len(candidates))):
        chosen.append(int(np.argmax(away)))
        away = np.minimum(away, np.linalg.norm(candidates - candidates[chosen[-1]], axis=1))
    points = np.column_stack([candidates[chosen], np.full(len(chosen), 1.5 * BAND)])
    points.setflags(write=False)
    return points


def _find_link_pairs(pairs: np.ndarray, links: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return link pairs, each with its first pair of bodies and the one past its last (k, 4), and these pairs in order.

    `links` (n,) is the link of each body.
    """
    pairs = np.array(pairs, np.int64).reshape(-1, 2)
    linked = links[pairs]
    order = np.lexsort((linked[:, 1], linked[:, 0]))
    pairs, linked = pairs[order], linked[order]
    distinct, first, counts = np.unique(linked, axis=0, return_index=True, return_counts=True)
    return np.column_stack([distinct, first, first + counts]).astype(np.int64), pairs


def _turns(model: Any) -> list[np.ndarray]:
    """Return each joint's rotation from its turned frame: z is its axis, x at right angles to the next joint's."""
    table = joint_table(model)
    turns, followed = [], set()
    for axis in table.axes:
        z = np.array([0.0, 0.0, 1.0])
        turns.append(pin.Quaternion.FromTwoVectors(z, axis).matrix() if np.any(axis) else np.eye(3))
    for i, parent in enumerate(table.parents[1:], 1):
        if parent == 0 or parent in followed or not np.any(table.axes[parent]):
            continue
        followed.add(parent)
        x, y, _ = turns[parent].T @ table.placements[i][:, :3] @ turns[i][:, 2]
        if np.hypot(x, y) > _SAME_DIRECTION:
            angle = np.arctan2(x, -y)  # the joint's own axis is at (0, -sin, cos) then
            turns[parent] = turns[parent] @ pin.AngleAxis(angle, z).matrix()
    return turns


def _joints(group: PlanningGroup, turns: list[np.ndarray]) -> BatchJoints:
    table = joints_of(group)
    n = len(table.parents)
    numbers = np.zeros((n, JOINT))
    sources, forms = np.zeros(n, np.int64), np.full(n, PLAIN)
    kinds = KINDS[table.kinds]
    for i in range(1, n):
        turn = turns[table.parents[i]].T @ table.placements[i][:, :3] @ turns[i]
        row = group.expand_velocity[table.idx_v[i]]
        sources[i] = int(np.argmax(np.abs(row)))
        assert np.count_nonzero(row) <= 1, "a joint follows at most one coordinate"
        offset = group.expand_offset[table.idx_v[i]]
        if kinds[i] == TURNING:
            forms[i], turn, more = _form(int(table.parents[i]), turn)
            offset = (offset + more + np.pi) % (2.0 * np.pi) - np.pi
        elif kinds[i] == SLIDING and table.parents[i] == 0:
            forms[i] = GROUNDED
        placement = np.c_[turn, turns[table.parents[i]].T @ table.placements[i][:, 3]]
        rest = (row[sources[i]], offset, 0.0, 0.0) if kinds[i] in (TURNING, SLIDING) else (0.0, 0.0, 0.0, 1.0)
        numbers[i] = *placement.ravel(), *rest
    joints = BatchJoints(n, np.array(table.parents), kinds, forms, sources, numbers.ravel().astype(np.float32))
    for array in joints[1:]:
        array.setflags(write=False)
    return joints


def turns_freely(joints: BatchJoints) -> bool:
    """Tell if a joint turns about a point: by a rotation vector, which has an origin."""
    return bool(joints.kinds.max(initial=TURNING) >= BALL)


def turn_from(joints: BatchJoints, group: PlanningGroup) -> BatchJoints:
    """Return the same joints, with rotation vectors that start at the group's origin."""
    numbers, balls = joints.numbers.reshape(-1, JOINT).copy(), {joint.name: joint for joint in group.joints}
    for i in np.flatnonzero(joints.kinds >= BALL).tolist():
        planned = balls[group.model.names[i]]
        quaternion = group.q_origin[planned.idx_q : planned.idx_q + planned.nq][-4:]
        numbers[i, QUATERNION:] = quaternion / np.linalg.norm(quaternion)
    numbers.setflags(write=False)
    return joints._replace(numbers=numbers.ravel())


def _form(parent: int, turn: np.ndarray) -> tuple[int, np.ndarray, float]:
    """Return a turning joint's form of placement, its rotation up to a turn about z, and that turn's angle [rad]."""
    if parent == 0:
        return GROUNDED, turn, 0.0
    for form, plain in ((SQUARE, _QUARTER_TURN), (PARALLEL, np.eye(3))):
        if np.abs(turn[:, 2] - plain[:, 2]).max() < _SAME_DIRECTION:
            rest = plain.T @ turn
            return form, plain, float(np.arctan2(rest[1, 0], rest[0, 0]))
    return PLAIN, turn, 0.0


def _place_balls(placement: Any, balls: np.ndarray) -> np.ndarray:
    return np.column_stack([balls[:, :3] @ placement.rotation.T + placement.translation, balls[:, 3]])


def _ball_about(balls: np.ndarray) -> np.ndarray:
    ball = np.empty(4)
    ball_around_balls(np.ascontiguousarray(balls), ball)
    return ball[None]


def _offsets(groups: Sequence[np.ndarray]) -> np.ndarray:
    return _offsets_of(np.array([len(rows) for rows in groups], np.int64))


def _offsets_of(sizes: np.ndarray) -> np.ndarray:
    return np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)


def _balls(groups: Sequence[np.ndarray]) -> np.ndarray:
    return np.concatenate([np.empty((0, 4)), *groups]).ravel().astype(np.float32)
