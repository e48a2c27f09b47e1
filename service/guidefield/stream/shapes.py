"""Shapes of a stream's obstacles and of its robot, each in its own frame: convex parts for proofs, boxes for plans.

Parts must contain their obstacle or body. `MOST_PARTS` costs time and how close they are, `CLOUD_BOXES` time and
motions; either changes to which pieces kept journals replay.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeVar

import coal
import numpy as np

from guidefield.collision.batch.scene_tables import parts_of
from guidefield.collision.obstacle_boxes import OwnBoxes, own_boxes
from guidefield.collision.part_tables import PartsTable, tree_layout
from guidefield.geometry.cache import allocate_in_memory
from guidefield.geometry.convex import CLUSTERS
from guidefield.geometry.curve_order import curve_order
from guidefield.geometry.surfaces import transform_points
from guidefield.kernels.collide.parts import (
    BALL_ROW,
    KIND,
    LEFT,
    LINK,
    OWN as PART_OF_NODE,
    PART,
    RIGHT,
    ROUND,
    SHAPE,
    TRIANGLE,
    Parts,
)
from guidefield.messages import scene as messages
from guidefield.read_only import ReadOnly, read_only
from guidefield.robot.group.group import PlanningGroup, memoized_for_alike
from guidefield.robot.link_bounds import convex_parts
from guidefield.scene.obstacle import Obstacle

MOST_PARTS = 8  # most parts of a mesh, which stand for its triangles in proofs
CLOUD_BOXES = 128  # boxes that stand for a cloud in planning, at most

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


@dataclass(frozen=True, eq=False)
class StreamShape(ReadOnly):
    """The shape of an obstacle in its own frame."""

    obstacle: Obstacle
    parts: Parts  # its convex parts; the first node is about all
    own: OwnBoxes  # the box about it
    # rounded boxes that stand for it in planning: rotation and translation, halves, radius, shape (b, 16) [m]
    boxes: np.ndarray

    @property
    def endless(self) -> bool:
        """True if it is a half-space."""
        return self.obstacle.endless

    @property
    def reach(self) -> float:
        """Largest distance of a point of it from the frame's origin [m]; infinite of a half-space."""
        balls = self.parts.balls.reshape(-1, BALL_ROW)[self.parts.links.reshape(-1, LINK)[:, LEFT] < 0]
        return float((np.linalg.norm(balls[:, :3], axis=1) + balls[:, 3]).max())


def shape_of(obstacle: Obstacle) -> StreamShape:
    """The shape of an obstacle that was built where its frame is the world's."""
    cloud = obstacle.cloud
    if cloud is None:
        return StreamShape(obstacle, parts_of(obstacle), own_boxes([obstacle]), _box_about(obstacle))
    points, radius = cloud.points[curve_order(cloud.points)], cloud.radius
    low, high = cloud.box[:1] - radius, cloud.box[1:] + radius
    own = OwnBoxes(np.eye(3).reshape(1, 9), 0.5 * (low + high), 0.5 * (high - low), np.hstack([low, high]))
    return StreamShape(obstacle, _balls_of_cloud(points, radius), own, _clusters(points, radius))


def _box_about(obstacle: Obstacle) -> np.ndarray:
    """The rounded box that represents an obstacle, but a cloud, in planning, shape (1, 16)."""
    if obstacle.endless:
        message = obstacle.message
        assert isinstance(message, messages.HalfSpace), "nothing else is"
        size = float(np.linalg.norm(message.normal))
        return _below(np.array([*message.normal, message.offset]) / size)
    shape, place, radius = (None if obstacle.facets is not None else obstacle.shape), obstacle.placement, 0.0
    low, high = obstacle.box
    if isinstance(shape, coal.Sphere | coal.Capsule):
        radius = shape.radius
    middle, halves = 0.5 * (low + high), np.maximum(0.5 * (high - low) - radius, 0.0)
    row = _box_rows(place.act(middle)[None], halves[None], np.array([radius]))
    row[0, :12].reshape(3, 4)[:, :3] = place.rotation
    return row


def _balls_of_cloud(points: np.ndarray, radius: float) -> Parts:
    """The balls of a cloud, points (n, 3) in an order in which neighbours stand together, as parts.

    Two neighbours have a node, two neighbouring nodes the next one. 20,000 points take 4 ms: a tree that is halved
    along its widest side, with hulls about some nodes, takes 20.
    """
    count = len(points)
    made = allocate_in_memory(tree_layout(count, 2 * count - 1, [0] * len(CLUSTERS)))
    made["numbers"].reshape(-1, PART)[:, :9] = np.tile(points, 3)
    made["numbers"].reshape(-1, PART)[:, ROUND] = radius
    made["shapes"].reshape(-1, SHAPE)[:, KIND] = TRIANGLE
    balls, links = made["balls"].reshape(-1, BALL_ROW)[::-1], made["links"].reshape(-1, LINK)[::-1]  # the root is first
    balls[:count, :3], balls[:count, 3], links[:count, PART_OF_NODE] = points, radius, np.arange(count)
    links[:count, : RIGHT + 1], links[count:, PART_OF_NODE], last = -1, -1, 2 * count - 2
    nodes, low = np.arange(count), np.ascontiguousarray(points.T)
    high, made_so_far = low, count
    while len(nodes) > 1:
        pairs = len(nodes) // 2
        first, second, lone = slice(0, 2 * pairs, 2), slice(1, 2 * pairs, 2), slice(2 * pairs, None)
        below, above = np.minimum(low[:, first], low[:, second]), np.maximum(high[:, first], high[:, second])
        half, level = 0.5 * (above - below), slice(made_so_far, made_so_far + pairs)
        balls[level, :3] = (below + half).T
        balls[level, 3] = np.sqrt((half * half).sum(axis=0)) * (1.0 + 1e-12) + radius
        links[level, LEFT], links[level, RIGHT] = last - nodes[first], last - nodes[second]
        nodes = np.concatenate([np.arange(made_so_far, made_so_far + pairs), nodes[lone]])
        low, high = np.hstack([below, low[:, lone]]), np.hstack([above, high[:, lone]])
        made_so_far += pairs
    read_only(*made.values())
    return Parts(**{name: made[name] for name in Parts._fields})


def _clusters(points: np.ndarray, radius: float) -> np.ndarray:
    """Boxes (b, 16) about runs of neighbours among sorted points (n, 3) [m]."""
    starts = np.unique(np.linspace(0, len(points), min(CLOUD_BOXES, len(points)), endpoint=False).astype(int))
    columns = np.ascontiguousarray(points.T)
    low, high = np.minimum.reduceat(columns, starts, axis=1).T, np.maximum.reduceat(columns, starts, axis=1).T
    return _box_rows(0.5 * (low + high), 0.5 * (high - low), np.full(len(starts), radius))


def _box_rows(centres: np.ndarray, halves: np.ndarray, radii: np.ndarray) -> np.ndarray:
    rows = np.zeros((len(centres), 16))
    rows[:, [0, 5, 10]] = 1.0
    rows[:, [3, 7, 11]], rows[:, 12:15], rows[:, 15] = centres, halves, radii
    return rows


def _below(plane: np.ndarray) -> np.ndarray:
    """A large box that represents a half-space (4,) in planning, shape (1, 16)."""
    normal, half = plane[:3], 10.0
    basis = np.linalg.qr(np.column_stack([normal, np.eye(3)]))[0][:, :3]
    row = np.zeros((1, 16))
    row[0, :12] = np.column_stack([basis, (plane[3] - half) * normal]).ravel()
    row[0, 12:15] = half
    return row


@memoized_for_alike
def solid_parts(group: PlanningGroup) -> tuple[np.ndarray, Parts, np.ndarray]:
    """The bodies of a robot as hulls of nearly convex pieces, in the frames of their joints.

    Pieces fill a body: what is inside of it touches them. Returns roots (r,), parts, and a point in each body (r, 3).
    """
    table, roots, inside = PartsTable(), list[int](), list[np.ndarray]()
    for shape, cut in zip(group.geometry.geometryObjects, convex_parts(group.robot, MOST_PARTS), strict=True):
        place = shape.placement
        if not isinstance(shape.geometry, coal.BVHModelBase):
            roots.append(table.add_shape(shape.geometry, place))
            points = np.array(shape.geometry.points()) if isinstance(shape.geometry, coal.Convex) else np.zeros((1, 3))
            inside.append(transform_points(place, points).mean(axis=0))
            continue
        surfaces = [shape.geometry.vertices()] if cut is None else [one.hull.vertices for one in (cut.hull, *cut.parts)]
        hull, *pieces = (transform_points(place, np.array(vertices)) for vertices in surfaces)
        roots.append(table.add_pieces(hull, pieces))
        inside.append((pieces or [hull])[0].mean(axis=0))
    made = np.array(roots, np.int64), table.tables(), np.array(inside).reshape(-1, 3)
    read_only(made[0], *made[1], made[2])
    return made
