"""The obstacles of a scene that rest as the distance kernels read them."""

from __future__ import annotations

import numpy as np

from guidefield.geometry.box_tree import box_tree
from guidefield.geometry.distance_bodies import (
    Body,
    BodyRows,
    balls_about,
    body_rows,
    body_tables,
    boxes_in_world,
    flat_frame,
    joined_rows,
    primitive,
    triangulated,
)
from guidefield.kept import kept_with
from guidefield.kernels.collide.primitive import (
    BOX as BOX_PLACED,
    CAPSULE as CAPSULE_PLACED,
    HALF_SPACE as HALF_SPACE_PLACED,
)
from guidefield.kernels.collide.primitives_layout import PLACED
from guidefield.kernels.distance.distance import BOX, CAPSULE, CYLINDER, HALF_SPACE, SHEET, SOLID, DistanceTables
from guidefield.scene.cloud_tables import cloud_tables
from guidefield.scene.obstacle import Obstacle
from guidefield.scene.scene import Scene


@kept_with
def distance_tables(scene: Scene) -> DistanceTables:
    """Tables of the obstacles of a scene that rest; computed once for each scene.

    A closed mesh is a solid for each of its connected pieces, together with the hollows within it, so that pieces that
    overlap are told apart from hollows.
    """
    resting = np.flatnonzero([one.motion is None for one in scene.obstacles])
    at_rest = [scene.obstacles[index] for index in resting.tolist()]
    placed = b"".join([one.placed for one in at_rest])
    rows = np.frombuffer(placed).reshape(-1, PLACED.size // 8)
    declared = resting[[bool(one.placed) for one in at_rest]]
    bounded = rows[:, 0] != HALF_SPACE_PLACED
    others = np.setdiff1d(resting, declared[bounded], assume_unique=True)
    made = [(index, body) for index in others.tolist() for body in bodies_of(scene.obstacles[index])]
    bodies = joined_rows(_primitives(rows[bounded]), body_rows([body for _, body in made]))
    owners = np.concatenate([declared[bounded], np.array([index for index, _ in made], np.int64)])
    order, nodes = np.argsort(owners, kind="stable"), np.empty((0, 6))
    endless, inside = (order[chosen] for chosen in _split(bodies.kinds[order] == HALF_SPACE))
    if len(inside):
        boxes = boxes_in_world(bodies.ordered(inside))
        tree = box_tree(boxes[:, :3], boxes[:, 3:])
        nodes, inside = tree.nodes, inside[tree.order]
    order = np.concatenate([endless, inside])
    return body_tables(bodies.ordered(order), owners[order], nodes)


def _split(chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Indices of what is chosen, and of the rest."""
    return np.flatnonzero(chosen), np.flatnonzero(~chosen)


def _primitives(placed: np.ndarray) -> BodyRows:
    """Boxes, cylinders and capsules that are declared by `PLACED`, shape (n, 12)."""
    declared, (x, y, z, w), radius = placed[:, 0], placed[:, 1:5].T, placed[:, -1]
    halves, half = placed[:, 8:11], placed[:, 10]
    box, capsule = declared == BOX_PLACED, declared == CAPSULE_PLACED
    long = half + np.where(capsule, radius, 0.0)
    reach = np.where(box[:, None], halves, np.column_stack([radius, radius, long]))
    placements = np.empty((len(placed), 3, 4))
    placements[:, 0, :3] = np.column_stack([1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)])
    placements[:, 1, :3] = np.column_stack([2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)])
    placements[:, 2, :3] = np.column_stack([2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)])
    placements[:, :, 3] = placed[:, 5:8]
    return BodyRows(
        kinds=np.where(box, BOX, np.where(capsule, CAPSULE, CYLINDER)),
        sizes=np.where(box[:, None], halves, np.column_stack([radius, half, np.zeros(len(placed))])),
        bounds=np.hstack([-reach, reach]),
        placements=placements,
        surfaces={},
        clouds=np.zeros(len(placed), np.int64),
    )


def bodies_of(obstacle: Obstacle) -> list[Body]:
    """The bodies of an obstacle in the world; of one that moves, where it is at first."""
    rotation, translation = obstacle.placement.rotation, obstacle.placement.translation
    body = primitive(obstacle.shape) if obstacle.facets is None else None
    if body is not None:
        return [body.placed(rotation, translation)]
    if obstacle.cloud is not None:
        return [balls_about(obstacle.cloud.points, obstacle.cloud.radius, cloud_tables(obstacle).address)]
    if obstacle.solid:
        return [
            triangulated(vertices, triangles, SOLID, neighbours).placed(rotation, translation)
            for vertices, triangles, neighbours in obstacle.surfaces
        ]
    sheets = []
    for vertices, triangles, neighbours in obstacle.surfaces:
        axes = flat_frame(vertices, triangles)
        along = vertices if (axes == np.eye(3)).all() else vertices @ axes  # of a million it takes long
        sheets.append(triangulated(along, triangles, SHEET, neighbours).placed(rotation @ axes, translation))
    return sheets
