"""Obstacles as tables for the lane kernels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin

from guidefield.collision.convex_parts import PartsTable
from guidefield.kept import kept_with
from guidefield.kernels.lane_math import BOX, CAPSULE, CYLINDER, HALF_SPACE, PRIMITIVE
from guidefield.kernels.lane_tables import LaneObstacles
from guidefield.kernels.lanes import LANES
from guidefield.kernels.separation import BLOCK, Parts
from guidefield.messages.scene import PointCloud
from guidefield.scene.cloud import cloud_balls
from guidefield.scene.obstacle import Obstacle

CLUSTER = 24
"""Most triangles of a mesh that stand behind one box."""


@dataclass(frozen=True, eq=False)
class LaneScene:
    """Obstacles for lanes.

    Attributes:
        obstacles: Their primitives; one of many triangles stands as several.
        parts: The shapes themselves.
    """

    obstacles: LaneObstacles
    parts: Parts


class _Tables(NamedTuple):
    """One obstacle's tables, as if there were no other.

    Attributes:
        sizes: How many stand-ins, nodes, parts and blocks of vertices there are.
        places: Kind, whether the primitive is the obstacle itself, and root of each stand-in, shape (k, 3).
        primitives: Their numbers, shape (k, PRIMITIVE), float32.
        boxes: Their boxes along the world's axes, the least x, y, z, then the largest, shape (k, 6), float32.
        balls, links, shapes, numbers, vertices: Those of its parts, row by row.
    """

    sizes: tuple[int, int, int, int]
    places: np.ndarray
    primitives: np.ndarray
    boxes: np.ndarray
    balls: np.ndarray
    links: np.ndarray
    shapes: np.ndarray
    numbers: np.ndarray
    vertices: np.ndarray


@kept_with
def _tables(obstacle: Obstacle) -> _Tables:
    """The tables of an obstacle, made once."""
    table = PartsTable()
    stand_ins = _stand_ins(obstacle, table)
    parts = table.tables()
    places = np.array([(kind, whole, root) for kind, whole, root, _ in stand_ins], np.int64).reshape(-1, 3)
    rows = np.array([row for *_, row in stand_ins]).reshape(-1, PRIMITIVE)
    boxes = np.array([_box(kind, row) for kind, _, _, row in stand_ins]).reshape(-1, 6)
    return _Tables(
        (len(places), len(parts.balls) // 4, len(parts.shapes) // 3, len(parts.vertices) // BLOCK),
        places,
        rows.astype(np.float32),
        boxes.astype(np.float32),
        parts.balls,
        parts.links.reshape(-1, 3),
        parts.shapes.reshape(-1, 3),
        parts.numbers,
        parts.vertices,
    )


_NOTHING = _Tables(
    (0, 0, 0, 0),
    np.empty((0, 3), np.int64),
    np.empty((0, PRIMITIVE), np.float32),
    np.empty((0, 6), np.float32),
    np.empty(0),
    np.empty((0, 3), np.int64),
    np.empty((0, 3), np.int64),
    np.empty(0),
    np.empty(0, np.float32),
)


def lane_scene(obstacles: tuple[Obstacle, ...], tested: np.ndarray) -> LaneScene:
    """Build the tables of obstacles: those of each one after the other.

    Args:
        obstacles: The obstacles.
        tested: Whether a robot's body must not touch an obstacle, shape (bodies, len(obstacles)).

    Raises:
        UnservedError: if a shape is of a kind that the kernels don't know.
    """
    tables = [_NOTHING, *map(_tables, obstacles)]
    sizes = np.array([table.sizes for table in tables])
    first = np.cumsum(sizes, axis=0) - sizes
    places, primitives, boxes, balls, links, shapes, numbers, vertices = (
        np.concatenate(column) for column in list(zip(*tables, strict=True))[1:]
    )
    places[:, 2] += np.repeat(first[:, 1], sizes[:, 0])
    links += (links >= 0) * np.repeat(first[:, [1, 1, 2]], sizes[:, 1], axis=0)
    shapes[:, 1] += np.repeat(first[:, 3], sizes[:, 2])
    kinds, whole, roots = np.ascontiguousarray(places.T)
    arrays = LaneObstacles(
        size=len(places),
        kinds=kinds,
        whole=whole,
        roots=roots,
        tested=np.repeat(tested, sizes[1:, 0], axis=1).astype(np.int64).ravel(),
        primitives=primitives.ravel(),
        boxes=_together(boxes),
    )
    parts = Parts(balls, links.ravel(), shapes.ravel(), numbers, vertices)
    for array in (*arrays[1:], *parts):
        array.setflags(write=False)
    return LaneScene(arrays, parts)


def _stand_ins(  # noqa: PLR0911  one for each kind
    obstacle: Obstacle, table: PartsTable
) -> list[tuple[int, bool, int, np.ndarray]]:
    """What stands for an obstacle: kind, whether it is the obstacle itself, its root, its numbers."""
    shape, placement = obstacle.shape, obstacle.placement
    if isinstance(obstacle.message, PointCloud):
        return _balls(*cloud_balls(obstacle.vertices), table)
    if isinstance(shape, coal.BVHModelBase):
        return [_cluster(corners, table) for corners in _clusters(obstacle.vertices[obstacle.triangles])]
    root = table.add_shape(shape, placement)
    if isinstance(shape, coal.Box):
        return [(BOX, True, root, _primitive(placement, np.array(shape.halfSide)))]
    if isinstance(shape, coal.Cylinder):
        return [(CYLINDER, True, root, _primitive(placement, np.array([0.0, 0.0, shape.halfLength]), shape.radius))]
    if isinstance(shape, coal.Capsule):
        return [(CAPSULE, True, root, _primitive(placement, np.array([0.0, 0.0, shape.halfLength]), shape.radius))]
    if isinstance(shape, coal.Sphere):
        return [(CAPSULE, True, root, _primitive(placement, np.zeros(3), shape.radius))]
    if isinstance(shape, coal.Halfspace):
        return [(HALF_SPACE, True, root, _half_space(shape, placement))]
    shape.computeLocalAABB()
    low, high = np.array(shape.aabb_local.min_), np.array(shape.aabb_local.max_)
    middle = pin.SE3(placement.rotation, placement.act(0.5 * (low + high)))
    return [(BOX, False, root, _primitive(middle, 0.5 * (high - low)))]


def _balls(centres: np.ndarray, radius: float, table: PartsTable) -> list[tuple[int, bool, int, np.ndarray]]:
    """Balls about points, neighbours together."""
    ordered = np.concatenate(_clusters(np.repeat(centres[:, None], 3, axis=1)))[:, 0]
    places, ball = [pin.SE3(np.eye(3), centre) for centre in ordered], coal.Sphere(radius)
    return [(CAPSULE, True, table.add_shape(ball, at), _primitive(at, np.zeros(3), radius)) for at in places]


def _clusters(corners: np.ndarray) -> list[np.ndarray]:
    """Triangles (t, 3, 3) in groups of neighbours."""
    waiting, groups = [corners], []
    while waiting:
        group = waiting.pop()
        if len(group) <= CLUSTER:
            groups.append(group)
            continue
        centres = group.mean(axis=1)
        order = np.argsort(centres[:, int(np.argmax(np.ptp(centres, axis=0)))], kind="stable")
        waiting += [group[order[: len(order) // 2]], group[order[len(order) // 2 :]]]
    return groups


def _cluster(corners: np.ndarray, table: PartsTable) -> tuple[int, bool, int, np.ndarray]:
    points = corners.reshape(-1, 3)
    centre = points.mean(axis=0)
    _, _, axes = np.linalg.svd(points - centre, full_matrices=True)
    along = (points - centre) @ axes.T
    middle = centre + 0.5 * (along.min(axis=0) + along.max(axis=0)) @ axes
    return (
        BOX,
        False,
        table.add_triangles(corners),
        _row(axes, middle, 0.5 * np.ptp(along, axis=0), 0.0),
    )


def _together(boxes: np.ndarray) -> np.ndarray:
    """Boxes (n, 6) sixteen together: the least x of all, y, z, then the largest; empty ones fill what is left."""
    blocks = -(-len(boxes) // LANES)
    ends = np.full((blocks * LANES, 6), np.inf, np.float32)
    ends[:, 3:] = -np.inf
    ends[: len(boxes)] = boxes
    return np.ascontiguousarray(ends.reshape(blocks, LANES, 6).transpose(0, 2, 1)).ravel()


def _box(kind: int, row: np.ndarray) -> np.ndarray:
    """The box along the world's axes about a primitive: the least x, y, z, then the largest."""
    axes, centre, halves, radius = row[:9].reshape(3, 3), row[9:12], row[12:15], row[15]
    if kind == HALF_SPACE:
        ends = np.repeat([-np.inf, np.inf], 3)
        for k in range(3):
            if abs(axes[2, k]) == 1.0:
                ends[3 * int(axes[2, k] > 0.0) + k] = centre[k]
        return ends
    reach = np.abs(axes.T) @ halves
    if kind == CAPSULE:
        reach = reach + radius
    elif kind == CYLINDER:
        reach = reach + radius * np.sqrt(np.maximum(1.0 - axes[2] ** 2, 0.0))
    return np.concatenate([centre - reach, centre + reach])


def _half_space(shape: Any, placement: Any) -> np.ndarray:
    normal = placement.rotation @ shape.n
    axes = np.zeros((3, 3))
    axes[2] = normal
    return _row(axes, placement.translation + shape.d * normal, np.zeros(3), 0.0)


def _primitive(placement: Any, halves: np.ndarray, radius: float = 0.0) -> np.ndarray:
    return _row(placement.rotation.T, placement.translation, halves, radius)


def _row(axes: np.ndarray, centre: np.ndarray, halves: np.ndarray, radius: float) -> np.ndarray:
    row: np.ndarray = np.concatenate([axes.ravel(), centre, halves, [radius]])
    assert len(row) == PRIMITIVE, "the kernels read as many"
    return row
