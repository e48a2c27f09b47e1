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
from guidefield.kernels.distance.distance import BOX, CAPSULE, CYLINDER, HALF_SPACE, SHEET, SOLID, DistanceTables
from guidefield.scene.carried import Rows, carried
from guidefield.scene.cloud_tables import cloud_tables
from guidefield.scene.obstacle import Obstacle
from guidefield.scene.placed import placed_rows, unplaced
from guidefield.scene.scene import Scene


@kept_with
def distance_tables(scene: Scene) -> DistanceTables:
    """Tables of the obstacles of a scene that rest; computed once for each scene.

    A closed mesh is a solid for each of its connected pieces, together with the hollows within it, so that pieces that
    overlap are told apart from hollows.
    """
    bodies, owners = _in_order(scene)
    endless, inside = _split(bodies.kinds == HALF_SPACE)
    nodes = np.empty((0, 6))
    if len(inside):
        boxes = np.take(bodies.boxes, inside, axis=0) if len(endless) else bodies.boxes
        tree = box_tree(boxes[:, :3], boxes[:, 3:])
        nodes, inside = tree.nodes, inside[tree.order]
    order = np.concatenate([endless, inside])
    return body_tables(bodies.ordered(order), owners[order], nodes)


def _in_order(scene: Scene) -> tuple[BodyRows, np.ndarray]:
    """The bodies of all obstacles that rest, in the order of these, and which each is of, shape (n,)."""
    primitives, placed = _primitives(scene), placed_rows(scene)
    declared = np.delete(np.arange(len(placed)), scene.others)
    half_spaces, bounded = (declared[chosen] for chosen in _split(placed[declared, 0] == HALF_SPACE_PLACED))
    if len(bounded) == len(placed):
        return primitives, bounded
    still = [index for index in unplaced(scene) if scene.obstacles[index].motion is None]
    others = sorted([*half_spaces.tolist(), *still])
    made = [(index, body) for index in others for body in bodies_of(scene.obstacles[index])]
    bodies = joined_rows(primitives.ordered(bounded), body_rows([body for _, body in made]))
    owners = np.concatenate([bounded, np.array([index for index, _ in made], np.int64)])
    order = np.argsort(owners, kind="stable")
    return bodies.ordered(order), owners[order]


def _split(chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Indices of what is chosen, and of the rest."""
    return np.flatnonzero(chosen), np.flatnonzero(~chosen)


def _over(known: BodyRows, rows: Rows, scene: Scene) -> BodyRows:
    fresh = _declared(placed_rows(scene)[rows.fresh])
    return BodyRows(
        kinds=rows.of(known.kinds, fresh.kinds),
        sizes=rows.of(known.sizes, fresh.sizes),
        bounds=rows.of(known.bounds, fresh.bounds),
        placements=rows.of(known.placements, fresh.placements),
        surfaces={},
        clouds=rows.of(known.clouds, fresh.clouds),
        boxes=rows.of(known.boxes, fresh.boxes),
    )


@carried(_over)
def _primitives(scene: Scene) -> BodyRows:
    """A row for each obstacle of a scene; that of what is no box, cylinder or capsule at rest says nothing."""
    return _declared(placed_rows(scene))


def _declared(placed: np.ndarray) -> BodyRows:
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
    bounds = np.hstack([-reach, reach])
    return BodyRows(
        kinds=np.where(box, BOX, np.where(capsule, CAPSULE, CYLINDER)),
        sizes=np.where(box[:, None], halves, np.column_stack([radius, half, np.zeros(len(placed))])),
        bounds=bounds,
        placements=placements,
        surfaces={},
        clouds=np.zeros(len(placed), np.int64),
        boxes=boxes_in_world(placements, bounds),
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
