"""Obstacles as tables for the lane kernels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from guidefield.collision.convex_parts import PartsTable
from guidefield.kernels.lane_math import BOX, CAPSULE, CYLINDER, HALF_SPACE, PRIMITIVE
from guidefield.kernels.lane_tables import LaneObstacles
from guidefield.kernels.lanes import LANES
from guidefield.kernels.separation import Parts
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


def lane_scene(obstacles: tuple[Obstacle, ...], tested: np.ndarray) -> LaneScene:
    """Build the tables of obstacles.

    Args:
        obstacles: The obstacles.
        tested: Whether a robot's body must not touch an obstacle, shape (bodies, len(obstacles)).

    Raises:
        UnservedError: if a shape is of a kind that the kernels don't know.
    """
    table = PartsTable()
    kinds, whole, roots, columns, rows = [], [], [], [], []
    for index, obstacle in enumerate(obstacles):
        for kind, is_whole, root, row in _stand_ins(obstacle, table):
            kinds.append(kind)
            whole.append(int(is_whole))
            roots.append(root)
            rows.append(row)
            columns.append(index)
    arrays = LaneObstacles(
        size=len(kinds),
        kinds=np.array(kinds, np.int64),
        whole=np.array(whole, np.int64),
        roots=np.array(roots, np.int64),
        tested=np.ascontiguousarray(tested[:, columns], np.int64).reshape(-1),
        primitives=np.array(rows, np.float32).reshape(-1),
        boxes=_boxes(kinds, rows),
    )
    for array in arrays[1:]:
        array.setflags(write=False)
    return LaneScene(arrays, table.tables())


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


def _boxes(kinds: list[int], rows: list[np.ndarray]) -> np.ndarray:
    """Boxes along the world's axes about primitives, sixteen together: the least x, y, z of all, then the largest."""
    blocks = -(-len(rows) // LANES)
    ends = np.full((2, 3, blocks * LANES), np.inf)
    ends[1] = -np.inf
    for index, (kind, row) in enumerate(zip(kinds, rows, strict=True)):
        axes, centre, halves, radius = row[:9].reshape(3, 3), row[9:12], row[12:15], row[15]
        if kind == HALF_SPACE:
            normal = axes[2]
            ends[0, :, index], ends[1, :, index] = -np.inf, np.inf
            along = np.abs(normal) == 1.0
            ends[1, along & (normal > 0.0), index] = centre[along & (normal > 0.0)]
            ends[0, along & (normal < 0.0), index] = centre[along & (normal < 0.0)]
            continue
        reach = np.abs(axes.T) @ halves
        if kind == CAPSULE:
            reach = reach + radius
        elif kind == CYLINDER:
            reach = reach + radius * np.sqrt(np.maximum(1.0 - axes[2] ** 2, 0.0))
        ends[0, :, index], ends[1, :, index] = centre - reach, centre + reach
    return ends.reshape(2, 3, blocks, LANES).transpose(2, 0, 1, 3).astype(np.float32).ravel()


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
