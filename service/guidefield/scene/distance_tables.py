"""Tables of a scene's obstacles at rest for the distance kernels, and of those that move for the barrier kernels.

Optimization and swept capsules read them. Columns are those of `geometry/distance_bodies.py` and
kernels/optimize/barrier.py. When only boxes, cylinders and capsules come or go, tables are updated to the very ones
that would be built anew.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from guidefield.geometry.cache import Allocate, is_large, make_in_place
from guidefield.geometry.curve_order import CurveOrder, along_curve, change_along
from guidefield.geometry.distance_bodies import (
    ROUNDING,
    SMALL_SHEET,
    BodyRows,
    DistanceBody,
    balls_about,
    bodies_in,
    body_rows,
    body_tables,
    box_body,
    box_nodes,
    join_rows,
    of_surface,
    primitive,
    sheets,
    surfaces_in,
    triangulated_body,
    write_surfaces,
)
from guidefield.kernels.collide.primitive import HALF_SPACE as HALF_SPACE_PLACED, primitive_bodies
from guidefield.kernels.distance.distance import CROPPED_SOLID, HALF_SPACE, SHEET, SOLID, DistanceTables
from guidefield.kernels.optimize.barrier import MovingBodies
from guidefield.memo import memoized
from guidefield.read_only import read_only
from guidefield.scene.incremental import Rows, incremental
from guidefield.scene.obstacle import Obstacle
from guidefield.scene.scene import Scene, is_other, placed_rows, rows_of, unplaced


class _Standing(NamedTuple):
    """Bodies at rest, and the order of those in the tree, by the middles of their boxes and numbered as obstacles."""

    tables: DistanceTables
    along: CurveOrder


def distance_tables(scene: Scene) -> DistanceTables:
    """Build the tables of the obstacles of a scene that are at rest; once for each scene.

    A closed mesh is a solid for each of its connected pieces, together with the hollows within it, so that pieces that
    overlap are distinguished from hollows.
    """
    return _standing(scene).tables


def _over(known: _Standing, rows: Rows, scene: Scene) -> _Standing | None:
    """Update the tables after a change; None unless only boxes, cylinders and capsules came or went."""
    fresh, tables, order = [scene.obstacles[index] for index in rows.fresh], known.tables, known.along.order
    placed, first = rows_of(fresh), len(tables.kinds) - len(order)
    endless, left = rows.now[tables.obstacles[:first]], len(order) - int((rows.now[order] < 0).sum())
    if (endless < 0).any() or any(is_other(one) for one in fresh) or (placed[:, 0] == HALF_SPACE_PLACED).any():
        return None
    others = _primitive_rows(placed)
    middles = 0.5 * (others.boxes[:, :3] + others.boxes[:, 3:])
    along, runs, turn = change_along(known.along, rows.now, rows.fresh, middles, left + len(fresh))
    step = Rows([(0, first), *((at if at < 0 else first + at, count) for at, count in runs)], len(tables.kinds))
    boxes = step.carry(tables.boxes, others.boxes[turn])
    if step.count == first or (tables.kinds[step.removed] >= HALF_SPACE).any() or not along.is_of(boxes[first:]):
        return None
    tables = tables._replace(
        kinds=step.carry(tables.kinds, others.kinds[turn]),
        obstacles=np.concatenate([endless, along.order]),
        placements=step.carry(tables.placements, others.placements[turn]),
        sizes=step.carry(tables.sizes, others.sizes[turn]),
        bounds=step.carry(tables.bounds, others.bounds[turn]),
        boxes=boxes,
        spans=_carry_zeros(step, tables.spans),
        nodes=box_nodes(boxes[first:]),
        clouds=_carry_zeros(step, tables.clouds),
    )
    read_only(*tables)
    return _Standing(tables, along)


def _carry_zeros(rows: Rows, values: np.ndarray) -> np.ndarray:
    """Carry numbers over that new bodies lack; return the same array if nobody has any."""
    if rows.count == rows.before and not values.any():
        return values
    return rows.carry(values, np.zeros((len(rows.fresh), *values.shape[1:]), values.dtype))


@incremental(_over)
def _standing(scene: Scene) -> _Standing:
    bodies, owners = _in_order(scene)
    endless, inside = _split(bodies.kinds == HALF_SPACE)
    boxes = np.take(bodies.boxes, inside, axis=0) if len(endless) else bodies.boxes
    along = along_curve(0.5 * (boxes[:, :3] + boxes[:, 3:]))
    nodes = box_nodes(np.take(boxes, along.order, axis=0)) if len(inside) else np.empty((0, 6))
    order = np.concatenate([endless, inside[along.order]])
    tables = body_tables(bodies.reorder(order), owners[order], nodes)
    return _Standing(tables, along._replace(order=tables.obstacles[len(endless) :]))


def _in_order(scene: Scene) -> tuple[BodyRows, np.ndarray]:
    """Return the bodies of all obstacles at rest, in their order, and the obstacle of each, shape (n,)."""
    placed = placed_rows(scene)
    primitives = _primitive_rows(placed)
    declared = np.delete(np.arange(len(placed)), scene.others)
    half_spaces, bounded = (declared[chosen] for chosen in _split(placed[declared, 0] == HALF_SPACE_PLACED))
    if len(bounded) == len(placed):
        return primitives, bounded
    still = [index for index in unplaced(scene) if scene.obstacles[index].motion is None]
    others = sorted([*half_spaces.tolist(), *still])
    thin = [index for index in others if _is_small_sheet(scene.obstacles[index])]
    thick = sorted(set(others).difference(thin))
    made = [(index, body) for index in thick for body in bodies_of(scene.obstacles[index])]
    bodies = join_rows(primitives.reorder(bounded), body_rows([body for _, body in made]))
    if thin:
        bodies = join_rows(bodies, _small_sheets([scene.obstacles[index] for index in thin]))
    owners = np.concatenate([bounded, np.array([*(index for index, _ in made), *thin], np.int64)])
    order = np.argsort(owners, kind="stable")
    return bodies.reorder(order), owners[order]


def _split(chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.flatnonzero(chosen), np.flatnonzero(~chosen)


def _primitive_rows(placed: np.ndarray) -> BodyRows:
    """Make the bodies of boxes, cylinders and capsules from rows of `primitive.PLACED`, shape (n, 12)."""
    count = len(placed)
    rows = BodyRows(
        kinds=np.empty(count, np.int64),
        sizes=np.empty((count, 3)),
        bounds=np.empty((count, 6)),
        placements=np.empty((count, 3, 4)),
        surfaces={},
        anchors={},
        clouds=np.zeros(count, np.int64),
        boxes=np.empty((count, 6)),
    )
    primitive_bodies(placed, ROUNDING, rows.kinds, rows.sizes, rows.bounds, rows.placements, rows.boxes)
    return rows


def bodies_of(obstacle: Obstacle) -> list[DistanceBody]:
    """Return the bodies of an obstacle in the world; of one that moves, where it is at first."""
    rotation, translation = obstacle.placement.rotation, obstacle.placement.translation
    body = primitive(obstacle.shape) if obstacle.facets is None else None
    if body is not None:
        return [body.place(rotation, translation)]
    if obstacle.cloud is not None:
        return [balls_about(obstacle.cloud.points, obstacle.cloud.radius, obstacle.cloud.tables.address)]
    if obstacle.recipe.content and is_large(obstacle.faces):
        return [body.place(rotation, translation) for body in _large_bodies(obstacle)]
    if obstacle.solid:
        solids = [
            box_body(box) if box is not None else triangulated_body(*part[:2], SOLID, part[2])
            for part, box in zip(obstacle.surfaces, obstacle.boxes, strict=True)
        ]
        return [body.place(rotation, translation) for body in _as_cropped(obstacle, solids)]
    if _is_small_sheet(obstacle):
        return bodies_in(_small_sheets([obstacle]))
    found = [triangulated_body(vertices, triangles, SHEET, beside) for vertices, triangles, beside in obstacle.surfaces]
    return [body.place(rotation, translation) for body in found]


def _is_small_sheet(obstacle: Obstacle) -> bool:
    has_inside = obstacle.solid or obstacle.convex or obstacle.cloud or obstacle.cropped
    return not has_inside and obstacle.faces <= SMALL_SHEET


def _small_sheets(obstacles: list[Obstacle]) -> BodyRows:
    placements = [obstacle.placement for obstacle in obstacles]
    return sheets(
        [obstacle.whole_surface for obstacle in obstacles],
        np.array([placement.rotation for placement in placements]),
        np.array([placement.translation for placement in placements]),
    )


def _large_bodies(obstacle: Obstacle) -> list[DistanceBody]:
    """Return the bodies of a large mesh in its own frame; from disk if they were made before."""

    def write(allocate: Allocate) -> None:
        write_surfaces(obstacle.surfaces, allocate)

    made = make_in_place("bodies", {"content": np.frombuffer(obstacle.recipe.content, np.uint8)}, write)
    if not obstacle.solid:
        return [of_surface(rows, SHEET) for rows in surfaces_in(made)]
    bodies = [
        of_surface(rows, SOLID) if box is None else box_body(box)
        for rows, box in zip(surfaces_in(made), obstacle.boxes, strict=True)
    ]
    return _as_cropped(obstacle, bodies)


def _as_cropped(obstacle: Obstacle, solids: list[DistanceBody]) -> list[DistanceBody]:
    """Mark those solids of an obstacle of which only a part is kept as cropped."""
    if obstacle.cropped is None:
        return solids
    parts = zip(solids, obstacle.cropped.parts, obstacle.cropped.anchors, strict=True)
    return [
        dataclasses.replace(body, kind=CROPPED_SOLID, anchor=anchor) if len(neighbours) else body
        for body, (_, _, neighbours), anchor in parts
    ]


@memoized
def moving_tables(scene: Scene) -> MovingBodies:
    """Build the tables of the obstacles of a scene that move; once for each scene, and once for all without any."""
    return _tables({index: scene.obstacles[index] for index in scene.others}) if scene.moves else _nothing()


@functools.cache
def _nothing() -> MovingBodies:
    return _tables({})


def _tables(obstacles: Mapping[int, Obstacle]) -> MovingBodies:
    """Build the tables of those that move among some obstacles, by their indices."""
    bodies, owners, of = [], [], []
    motions = [(index, one.motion) for index, one in obstacles.items() if one.motion is not None]
    for k, (index, motion) in enumerate(motions):
        back = motion.placements[0].inverse()
        made = [body.place(back.rotation, back.translation) for body in bodies_of(obstacles[index])]
        bodies += made
        owners += [index] * len(made)
        of += [k] * len(made)
    lasts = np.cumsum([len(motion.times) for _, motion in motions], dtype=np.int64)
    counts = np.array([len(motion.times) for _, motion in motions], np.int64)
    rest = np.zeros((1, 6))
    tables = MovingBodies(
        bodies=body_tables(body_rows(bodies), owners, np.empty((0, 6))),
        motions=np.array(of, np.int64),
        spans=np.column_stack([lasts - counts, lasts]),
        times=np.concatenate([np.empty(0), *(motion.times for _, motion in motions)]),
        placements=np.array([p.homogeneous[:3] for _, motion in motions for p in motion.placements]).reshape(-1, 3, 4),
        twists=np.concatenate([np.empty((0, 6)), *(np.vstack([motion.twists, rest]) for _, motion in motions)]),
    )
    read_only(*tables[1:])
    return tables
