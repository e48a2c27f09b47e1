"""Shapes as convex solids in trees of balls, in their own frames; for the judge of streams."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

import coal
import numpy as np

from guidefield.errors import MalformedRequest
from guidefield.geometry.curve_order import curve_order
from guidefield.kernels.kinematics.forward_kinematics import joint_places
from guidefield.kernels.stream.judge import JudgedRobot, JudgedShapes, Solids
from guidefield.kernels.stream.room import RoomRobot
from guidefield.messages import scene as messages
from guidefield.read_only import ReadOnly
from guidefield.robot.bodies.convex_parts import convex_parts
from guidefield.robot.bodies.sphere_cover import coverage
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.kinematics import group_joints
from guidefield.scene.obstacle import Obstacle

Named = TypeVar("Named", bound=tuple[Any, ...])


def read_only_views(named: Named, *written: str) -> Named:
    """A named tuple with a read-only view in place of each array."""
    fields = named._fields  # type: ignore[attr-defined]  # a named tuple has them
    pairs = zip(fields, named, strict=True)
    views = [_view(one) if isinstance(one, np.ndarray) and name not in written else one for name, one in pairs]
    return type(named)(*views)


def _view(array: np.ndarray) -> np.ndarray:
    view = array.view()
    view.setflags(write=False)
    return view


LEAF = 8  # solids in a leaf of a tree


@dataclass(frozen=True, eq=False)
class Convexes(ReadOnly):
    """Convex solids, as `Solids` has them; `first` counts from 0."""

    count: np.ndarray  # points of each, shape (n,)
    points: np.ndarray  # shape (p, 3) [m]
    disc: np.ndarray  # radii of discs swept over them, shape (n,) [m]
    axis: np.ndarray  # across which axes, shape (n, 3)
    rounding: np.ndarray  # radii of balls swept over all that, shape (n,) [m]

    @cached_property
    def balls(self) -> np.ndarray:
        """A ball about each, shape (n, 4) [m]."""
        if len(self.points) == len(self.count):
            return np.column_stack([self.points, (self.disc + self.rounding) * (1.0 + 1e-12)])
        starts = np.cumsum(self.count) - self.count
        low, high = np.minimum.reduceat(self.points, starts), np.maximum.reduceat(self.points, starts)
        centres = 0.5 * (low + high)
        far = np.linalg.norm(self.points - np.repeat(centres, self.count, axis=0), axis=1)
        radii = np.maximum.reduceat(far, starts)
        return np.column_stack([centres, (radii + self.disc + self.rounding) * (1.0 + 1e-12)])

    def reorder(self, order: np.ndarray) -> Convexes:
        """The same in another order, indices of shape (n,); all must have as many points."""
        points = self.points.reshape(len(self.count), -1, 3)[order].reshape(-1, 3)
        return Convexes(self.count[order], points, self.disc[order], self.axis[order], self.rounding[order])


def polytope(points: np.ndarray, rounding: float = 0.0) -> Convexes:
    """The hull of points, shape (k, 3), rounded [m]."""
    return Convexes(
        np.array([len(points)]), np.array(points, float), np.zeros(1), np.zeros((1, 3)), np.array([rounding])
    )


def join_convexes(parts: Sequence[Convexes]) -> Convexes:
    """Several one after the other."""
    return Convexes(*(np.concatenate([getattr(part, name) for part in parts]) for name in Convexes.__annotations__))


def solids_of(several: Sequence[Convexes]) -> Solids:
    """Several one after the other, as the judge knows them."""
    parts = join_convexes(several)
    first = (np.cumsum(parts.count) - parts.count).astype(np.int64)
    balls = np.concatenate([one.balls for one in several])
    arrays = (parts.points, parts.disc, parts.axis, parts.rounding, balls)
    solids = Solids(first, parts.count.astype(np.int64), *(np.ascontiguousarray(array, float) for array in arrays))
    return read_only_views(solids)


def convex_of(shape: Any) -> Convexes | None:
    """The solid of a convex Coal shape in its own frame; None of a mesh, which isn't convex.

    Raises:
        TypeError: if it is of a kind that can't be judged.
    """
    rounding = float(shape.getSweptSphereRadius()) if hasattr(shape, "getSweptSphereRadius") else 0.0
    if isinstance(shape, coal.BVHModelBase):
        return None
    if isinstance(shape, coal.Sphere):
        return polytope(np.zeros((1, 3)), shape.radius + rounding)
    if isinstance(shape, coal.Capsule):
        return polytope(_ends(shape.halfLength), shape.radius + rounding)
    if isinstance(shape, coal.Cylinder):
        axis = np.array([[0.0, 0.0, 1.0]])
        return Convexes(np.array([2]), _ends(shape.halfLength), np.array([shape.radius]), axis, np.array([rounding]))
    if isinstance(shape, coal.Box):
        return polytope(_corners(np.array(shape.halfSide)), rounding)
    if isinstance(shape, coal.Convex):
        return polytope(np.array(shape.points()), rounding)
    raise TypeError(f"a stream can't judge a {type(shape).__name__}")


def _ends(half: float) -> np.ndarray:
    return np.array([[0.0, 0.0, -half], [0.0, 0.0, half]])


def _corners(halves: np.ndarray) -> np.ndarray:
    signs: np.ndarray = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
    corners: np.ndarray = signs * halves
    return corners


@dataclass(frozen=True, eq=False)
class JudgedShape(ReadOnly):
    """The shape of an obstacle in its own frame, see `JudgedShapes`."""

    solids: Convexes  # its convex solids; of a half-space a point that nobody looks at
    nodes: np.ndarray  # shape (k, 4) [m]; the first is about all
    links: np.ndarray  # shape (k, 4), from 0
    plane: np.ndarray | None  # normal and offset of a half-space, shape (4,) [m]; None of others
    closed: bool
    # rounded boxes that stand for it in planning: rotation and translation, halves, radius, shape (b, 16) [m]
    boxes: np.ndarray

    @property
    def reach(self) -> float:
        """How far a point of it is from the frame's origin, at most [m]; infinite of a half-space."""
        if self.plane is not None:
            return float(np.inf)
        balls = self.solids.balls
        return float((np.linalg.norm(balls[:, :3], axis=1) + balls[:, 3]).max())


def shape_of(obstacle: Obstacle) -> JudgedShape:
    """The shape of an obstacle that was built.

    Of what has a placement of its own the frame is that one; of polygons, half-spaces and clouds the world.
    """
    message = obstacle.message
    if isinstance(message, messages.HalfSpace):
        normal = np.array(message.normal) / np.linalg.norm(message.normal)
        plane = np.array([*normal, message.offset / np.linalg.norm(message.normal)])
        return JudgedShape(polytope(np.zeros((1, 3))), *_tree(np.zeros((1, 4))), plane, False, _below(plane))
    if obstacle.cloud is not None:
        return _cloud(obstacle.cloud.points, obstacle.cloud.radius)
    convex = convex_of(obstacle.shape)
    if convex is not None:
        return _one(convex)
    vertices, triangles = obstacle.recipe.surface(message)
    return _triangles(np.asarray(vertices)[np.asarray(triangles)], obstacle.solid)


def _one(solid: Convexes) -> JudgedShape:
    nodes, links = _tree(solid.balls)
    low, high = solid.points.min(axis=0), solid.points.max(axis=0)
    grown = solid.disc[0] * np.array([1.0, 1.0, 0.0])
    boxes = _box_rows((0.5 * (low + high))[None], (0.5 * (high - low) + grown)[None], solid.rounding)
    return JudgedShape(solid, nodes, links, None, False, boxes)


def _triangles(corners: np.ndarray, closed: bool) -> JudgedShape:
    """Of triangles (t, 3, 3)."""
    count = len(corners)
    solids = Convexes(np.full(count, 3), corners.reshape(-1, 3), np.zeros(count), np.zeros((count, 3)), np.zeros(count))
    solids = solids.reorder(curve_order(corners.mean(axis=1)))
    nodes, links = _tree(solids.balls)
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    boxes = _box_rows((0.5 * (low + high))[None], (0.5 * (high - low))[None], np.zeros(1))
    return JudgedShape(solids, nodes, links, None, closed, boxes)


def _cloud(points: np.ndarray, radius: float) -> JudgedShape:
    """Of points (n, 3), put in an order in which neighbours stand together."""
    points, count = points[curve_order(points)], len(points)
    solids = Convexes(np.ones(count, int), points, np.zeros(count), np.zeros((count, 3)), np.full(count, radius))
    nodes, links = _tree(solids.balls)
    return JudgedShape(solids, nodes, links, None, False, _clusters(points, radius))


CLUSTERS = 128  # about so many boxes stand for a cloud in planning


def _clusters(points: np.ndarray, radius: float) -> np.ndarray:
    """Boxes (b, 16) about runs of neighbours among sorted points (n, 3) [m]."""
    starts = np.unique(np.linspace(0, len(points), min(CLUSTERS, len(points)), endpoint=False).astype(int))
    columns = np.ascontiguousarray(points.T)
    low, high = np.minimum.reduceat(columns, starts, axis=1).T, np.maximum.reduceat(columns, starts, axis=1).T
    return _box_rows(0.5 * (low + high), 0.5 * (high - low), np.full(len(starts), radius))


def _box_rows(centres: np.ndarray, halves: np.ndarray, radii: np.ndarray) -> np.ndarray:
    rows = np.zeros((len(centres), 16))
    rows[:, [0, 5, 10]] = 1.0
    rows[:, [3, 7, 11]], rows[:, 12:15], rows[:, 15] = centres, halves, radii
    return rows


def _below(plane: np.ndarray) -> np.ndarray:
    """A large box that stands for a half-space (4,) in planning, shape (1, 16)."""
    normal, half = plane[:3], 10.0
    basis = np.linalg.qr(np.column_stack([normal, np.eye(3)]))[0][:, :3]
    row = np.zeros((1, 16))
    row[0, :12] = np.column_stack([basis, (plane[3] - half) * normal]).ravel()
    row[0, 12:15] = half
    return row


def _tree(balls: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nodes (k, 4) and links (k, 4) of a tree over balls (n, 4) that stand in order, the root first."""
    count = len(balls)
    if count == 1:
        return balls.copy(), np.array([[-1, -1, 0, 1]])
    # one coordinate after the other, which NumPy does in a fraction of the time
    centres, radii = np.ascontiguousarray(balls[:, :3].T), balls[:, 3]
    starts = np.arange(0, count, LEAF)
    ends = np.minimum(starts + LEAF, count)
    low = np.minimum.reduceat(centres - radii, starts, axis=1)
    high = np.maximum.reduceat(centres + radii, starts, axis=1)
    levels = [(low.T, high.T, np.column_stack([np.full((len(starts), 2), -1), starts, ends]))]
    while low.shape[1] > 1:
        pairs = np.arange(0, low.shape[1], 2)
        seconds = np.where(pairs + 1 < low.shape[1], pairs + 1, -1)
        links = np.column_stack([pairs, seconds, np.zeros((len(pairs), 2), int)])
        low, high = np.minimum.reduceat(low, pairs, axis=1), np.maximum.reduceat(high, pairs, axis=1)
        levels.append((low.T, high.T, links))
    levels.reverse()
    offset, nodes, all_links = 0, list[np.ndarray](), list[np.ndarray]()
    for low, high, below in levels:
        half = 0.5 * (high - low)
        nodes.append(np.column_stack([low + half, np.linalg.norm(half, axis=1) * (1.0 + 1e-12)]))
        offset += len(low)
        shifted = below.copy()
        shifted[:, :2] += offset * (below[:, :2] >= 0)
        all_links.append(shifted)
    return np.ascontiguousarray(np.concatenate(nodes)), np.concatenate(all_links)


def shapes_of(shapes: Sequence[JudgedShape]) -> JudgedShapes:
    """Several obstacles' shapes, as the judge knows them; one that nobody asks about where there is none."""
    given = list(shapes) or [JudgedShape(polytope(np.zeros((1, 3))), *_tree(np.zeros((1, 4))), None, False, _NONE)]
    counts = np.array([len(one.solids.count) for one in given])
    sizes = np.array([len(one.nodes) for one in given])
    solid_first, node_first = np.cumsum(counts) - counts, np.cumsum(sizes) - sizes
    links = [
        one.links
        + np.array([node, node, solid, solid]) * np.column_stack([one.links[:, :2] >= 0, one.links[:, 2:] >= 0])
        for one, node, solid in zip(given, node_first.tolist(), solid_first.tolist(), strict=True)
    ]
    closed = np.array(
        [
            (first, first + count) if one.closed else (0, 0)
            for one, first, count in zip(given, solid_first, counts, strict=True)
        ]
    )
    judged = JudgedShapes(
        roots=node_first.astype(np.int64),
        nodes=np.concatenate([one.nodes for one in given]),
        links=np.concatenate(links).astype(np.int64),
        flat=np.array([one.plane is not None for one in given]).astype(np.int64),
        planes=np.array([np.zeros(4) if one.plane is None else one.plane for one in given]),
        closed=closed.astype(np.int64).reshape(-1, 2),
        solids=solids_of([one.solids for one in given]),
    )
    return read_only_views(judged)


_NONE = np.empty((0, 16))


MOST_PARTS = 8  # most parts of a mesh, which stand for it: nothing asks its triangles


def require_one_axis(group: PlanningGroup) -> None:
    """Require that each joint of a group's model turns about one axis or slides along one.

    Raises:
        MalformedRequest: if one doesn't.
    """
    for joint, name in zip(group.model.joints[1:], list(group.model.names)[1:], strict=True):
        if joint.nv != 1:
            raise MalformedRequest(
                f"a stream isn't served for joint {name!r}, which has {joint.nv} degrees of freedom: only for joints"
                " that turn about one axis or slide along one; leave it out of the `group`",
                unserved="group",
                joint=name,
            )


def judged_robot(group: PlanningGroup, own: np.ndarray) -> JudgedRobot:
    """The robot for the judge.

    Args:
        own: Pairs of its bodies that must not touch, shape (p, 2).
    """
    shapes = list(group.geometry.geometryObjects)
    bodies: list[list[Convexes]] = []
    for shape, cut in zip(shapes, convex_parts(group.robot, MOST_PARTS), strict=True):
        solid = convex_of(shape.geometry)
        if solid is not None:
            solids = [solid]
        elif cut is None:
            solids = [polytope(np.array(shape.geometry.vertices()))]
        else:
            hulls = [cut.hull, *(cut.parts if len(cut.parts) > 1 else ())]
            solids = [polytope(np.asarray(part.hull.vertices)) for part in hulls]
        bodies.append([_transform(one, shape.placement) for one in solids])
    counts = [len(one) for one in bodies]
    solids_table = solids_of([solid for one in bodies for solid in one])
    first = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    robot = JudgedRobot(
        joints=group_joints(group),
        carriers=np.array([shape.parentJoint for shape in shapes], np.int64),
        balls=np.ascontiguousarray(solids_table.balls[first[:-1]]),
        first=first,
        own=np.ascontiguousarray(own, np.int64).reshape(-1, 2),
        solids=solids_table,
    )
    return read_only_views(robot)


def _transform(solid: Convexes, placement: Any) -> Convexes:
    points = solid.points @ placement.rotation.T + placement.translation
    return Convexes(solid.count, points, solid.disc, solid.axis @ placement.rotation.T, solid.rounding)


def room_robot(group: PlanningGroup) -> RoomRobot:
    """The robot as balls, for planning, with memory of its own: not for two threads."""
    shapes = list(group.geometry.geometryObjects)
    carriers, bounds, balls, counts = [], [], [np.empty((0, 4))], []
    for shape, covered in zip(shapes, coverage(group.robot).shapes, strict=True):
        if shape.parentJoint == 0:
            continue
        carriers.append(shape.parentJoint)
        bounds.append(_balls(covered.cover.bound[None], shape.placement)[0])
        balls.append(_balls(covered.cover.spheres, shape.placement))
        counts.append(len(balls[-1]))
    joints = group_joints(group)
    robot = RoomRobot(
        joints=joints,
        carriers=np.array(carriers, np.int64),
        bounds=np.array(bounds).reshape(-1, 4),
        first=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        balls=np.concatenate(balls),
        places=joint_places(joints),
    )
    return read_only_views(robot)


def _balls(balls: np.ndarray, placement: Any) -> np.ndarray:
    """Balls (n, 4) of a shape's frame in that of its joint."""
    return np.column_stack([balls[:, :3] @ placement.rotation.T + placement.translation, balls[:, 3]])
