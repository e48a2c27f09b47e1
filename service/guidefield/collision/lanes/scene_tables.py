"""Obstacles as tables for the lane kernels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin

from guidefield.collision.convex_parts import PartsTable
from guidefield.collision.lanes.memory import scene_memory
from guidefield.kept import kept_with
from guidefield.kernels.collide.arena import SCENE_WORDS
from guidefield.kernels.collide.balls import BALL_ROW
from guidefield.kernels.collide.layout import CLOUD, LaneObstacles
from guidefield.kernels.collide.parts import LINK, SHAPE, Parts
from guidefield.kernels.collide.primitive import BOX, CENTRE, HALVES, PRIMITIVE, ROUND
from guidefield.kernels.collide.primitives_layout import PLACED, primitive_tables
from guidefield.kernels.simd.blocks import BLOCK
from guidefield.kernels.simd.packing import Words, packed
from guidefield.kernels.simd.vector_model import LANES
from guidefield.scene.cloud import Cloud
from guidefield.scene.cloud_tables import cloud_tables
from guidefield.scene.obstacle import Obstacle
from guidefield.scene.scene import Scene

CLUSTER = 24
"""Most triangles of a mesh that stand behind one box."""


class _Tables(NamedTuple):
    """Tables of some obstacles, as if there were no other.

    Attributes:
        sizes: How many stand-ins, nodes, parts and blocks of vertices there are.
        places: Kind, whether the primitive is the obstacle itself, root of each stand-in, and the address of the words
            of what is a cloud, else 0, shape (k, 4).
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


@dataclass(frozen=True, eq=False)
class LaneScene:
    """Obstacles for lanes, primitives first.

    Attributes:
        owners: Which obstacle of the scene each of them stands for, shape (n,).
        words: As the kernels know them, obstacles and parts, packed.
        made: Makes the same as arrays; holds their memory.
    """

    owners: np.ndarray
    words: Words
    made: Callable[[], tuple[LaneObstacles, Parts]]

    @cached_property
    def tables(self) -> tuple[LaneObstacles, Parts]:
        """Obstacles, of which one of many triangles stands as several; which are tested is left open. Their shapes."""
        return self.made()


@kept_with
def lane_scene(scene: Scene) -> LaneScene:
    """Build the tables of a scene's obstacles: primitives by a kernel, of the others those that are known by obstacle.

    Raises:
        UnservedError: if a shape is of a kind that the kernels don't know.
    """
    given = scene.obstacles
    placed = b"".join([one.placed for one in given])
    owners, others = np.arange(len(given)), [index for index, one in enumerate(given) if not one.placed]
    if not others:
        return _primitives(placed, owners)
    tables = [_tables(given[index]) for index in others]
    owners = np.delete(owners, others)
    owners = np.concatenate([owners, np.repeat(others, [table.sizes[0] for table in tables])])
    obstacles, parts = made = _with(*_primitives(placed, owners).tables, tables)
    for array in (*obstacles[1:], *parts):
        array.setflags(write=False)
    return LaneScene(owners, packed(made), lambda: made)


def _primitives(placed: bytes, owners: np.ndarray) -> LaneScene:
    """Tables of primitives, `PLACED` one after the other, with boxes for as many obstacles as there are owners."""
    layout = scene_memory(len(placed) // PLACED.size, len(owners))
    memory, words = np.zeros(layout.size, np.int64), np.empty(SCENE_WORDS, np.int64)
    begins = primitive_tables(np.frombuffer(placed), layout.offsets, memory, words)
    memory.setflags(write=False)

    def made() -> tuple[LaneObstacles, Parts]:
        views = layout.views(memory, begins)
        obstacles = LaneObstacles(len(owners), *(views[name] for name in LaneObstacles._fields[1:]))
        return obstacles, Parts(**{name: views[name] for name in Parts._fields})

    return LaneScene(owners, words, made)


def _with(obstacles: LaneObstacles, parts: Parts, tables: list[_Tables]) -> tuple[LaneObstacles, Parts]:
    """Tables of primitives with those of other obstacles behind them."""
    n = len(obstacles.kinds)
    sizes = np.array([(n, n, n, len(parts.vertices) // BLOCK), *(table.sizes for table in tables)])
    first = (np.cumsum(sizes, axis=0) - sizes)[1:]
    sizes = sizes[1:]
    places, primitives, boxes, balls, links, shapes, numbers, vertices = (
        np.concatenate(column) for column in list(zip(*tables, strict=True))[1:]
    )
    places[:, 2] += np.repeat(first[:, 1], sizes[:, 0])
    links += (links >= 0) * np.repeat(first[:, [1, 1, 2]], sizes[:, 1], axis=0)
    shapes[:, 1] += np.repeat(first[:, 3], sizes[:, 2])
    index = np.arange(n, n + len(places))
    all_boxes = obstacles.boxes.copy()
    all_boxes.reshape(-1, 6, LANES)[index // LANES, :, index % LANES] = boxes
    return LaneObstacles(
        size=obstacles.size,
        kinds=np.concatenate([obstacles.kinds, places[:, 0]]),
        whole=np.concatenate([obstacles.whole, places[:, 1]]),
        roots=np.concatenate([obstacles.roots, places[:, 2]]),
        tested=obstacles.tested,
        primitives=np.concatenate([obstacles.primitives, primitives.ravel()]),
        boxes=all_boxes,
        clouds=np.concatenate([obstacles.clouds, places[:, 3]]),
    ), Parts(
        balls=np.concatenate([parts.balls, balls]),
        links=np.concatenate([parts.links, links.ravel()]),
        shapes=np.concatenate([parts.shapes, shapes.ravel()]),
        numbers=np.concatenate([parts.numbers, numbers]),
        vertices=np.concatenate([parts.vertices, vertices]),
    )


@kept_with
def _tables(obstacle: Obstacle) -> _Tables:
    """The tables of an obstacle that is no primitive, made once."""
    table = PartsTable()
    stand_ins = _stand_ins(obstacle, table)
    parts = table.tables()
    address = 0 if obstacle.cloud is None else cloud_tables(obstacle).address
    places = np.array([(*place, address) for *place, _ in stand_ins], np.int64).reshape(-1, 4)
    rows = np.array([row for *_, row in stand_ins]).reshape(-1, PRIMITIVE)
    boxes = np.array([_box(row) for *_, row in stand_ins]).reshape(-1, 6)
    return _Tables(
        (len(places), len(parts.balls) // BALL_ROW, len(parts.shapes) // SHAPE, len(parts.vertices) // BLOCK),
        places,
        rows.astype(np.float32),
        boxes.astype(np.float32),
        parts.balls,
        parts.links.reshape(-1, LINK),
        parts.shapes.reshape(-1, SHAPE),
        parts.numbers,
        parts.vertices,
    )


def _stand_ins(obstacle: Obstacle, table: PartsTable) -> list[tuple[int, bool, int, np.ndarray]]:
    """What stands for an obstacle: kind, whether it is the obstacle itself, its root, its numbers."""
    shape, placement = obstacle.shape, obstacle.placement
    if obstacle.cloud is not None:
        return [_cloud(obstacle.cloud, table)]
    if isinstance(shape, coal.BVHModelBase):
        return [_cluster(corners, table) for corners in _clusters(obstacle.vertices[obstacle.triangles])]
    root = table.add_shape(shape, placement)
    shape.computeLocalAABB()
    low, high = np.array(shape.aabb_local.min_), np.array(shape.aabb_local.max_)
    middle = placement.act(0.5 * (low + high))
    return [(BOX, False, root, _row(placement.rotation.T, middle, 0.5 * (high - low)))]


def _cloud(cloud: Cloud, table: PartsTable) -> tuple[int, bool, int, np.ndarray]:
    """One ball at the origin stands for all; the numbers are those of the box about them."""
    low, high = cloud.box[0] - cloud.radius, cloud.box[1] + cloud.radius
    root = table.add_shape(coal.Sphere(cloud.radius), pin.SE3.Identity())
    return CLOUD, True, root, _row(np.eye(3), 0.5 * (low + high), 0.5 * (high - low))


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
        _row(axes, middle, 0.5 * np.ptp(along, axis=0)),
    )


def _box(row: np.ndarray) -> np.ndarray:
    """The box along the world's axes about a box or ball: the least x, y, z, then the largest."""
    reach = np.abs(row[:CENTRE].reshape(3, 3).T) @ row[HALVES:ROUND] + row[ROUND]
    centre = row[CENTRE:HALVES]
    return np.concatenate([centre - reach, centre + reach])


def _row(axes: np.ndarray, centre: np.ndarray, halves: Any, radius: float = 0.0) -> np.ndarray:
    """The numbers of a primitive, as `collide.primitive` has them."""
    row = np.empty(PRIMITIVE)
    row[:CENTRE], row[CENTRE:HALVES], row[HALVES:ROUND], row[ROUND] = axes.ravel(), centre, halves, radius
    return row
