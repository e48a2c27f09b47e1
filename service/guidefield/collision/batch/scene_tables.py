"""Obstacles as tables for SIMD batches, updated when a scene differs little from a known one.

Primitives are written by a kernel; a mesh stands as convex solids or boxes about clusters of triangles, each the root
of a tree of parts; a cloud as balls. Columns are those of kernels/collide (layout.py, primitive.py, parts.py).
The shapes that represent an obstacle must contain it; parts are the exact shapes that decide. The memory of a scene's
primitives and of a world's scratch is laid out here, too: lengths, and offsets in the order in which `lay_out` and
`primitive_tables` read them.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin

from guidefield.collision.batch.robot_tables import BatchRobot
from guidefield.collision.batch.surface_tables import (
    CLUSTER,
    boxes_about,
    cloud_parts,
    cluster_rows,
    flat_forest,
    large_surface,
)
from guidefield.collision.part_tables import PartsTable, tree_above
from guidefield.collision.solids import MOST_TRIANGLES
from guidefield.deadline import Deadline
from guidefield.geometry.convex import mesh_tree
from guidefield.geometry.mesh_surface import own_hull
from guidefield.geometry.surfaces import transform_points
from guidefield.kernels.collide.gjk import WORK
from guidefield.kernels.collide.layout import (
    AXIS_AND_REACH,
    CLOUD,
    FOUND,
    GRID_SIDES,
    HIT,
    HITS,
    LINE,
    SCENE_WORDS,
    BatchObstacles,
    BatchWorld,
    Scratch,
)
from guidefield.kernels.collide.parts import BALL_ROW, FIRST_BLOCK, LINK, PART, SHAPE, Parts
from guidefield.kernels.collide.primitive import BOX, CENTRE, HALVES, PRIMITIVE, ROUND, primitive_tables
from guidefield.kernels.jit.arrays import array_types
from guidefield.kernels.kinematics.poses import POSE
from guidefield.kernels.simd.packing import AROUND, BLOCK, Words, pack
from guidefield.kernels.simd.vector import LANES
from guidefield.memo import MISSING, Answers, MemoSet, memoized
from guidefield.messages import scene as messages
from guidefield.read_only import read_only
from guidefield.scene.cloud import Cloud
from guidefield.scene.incremental import Rows, incremental
from guidefield.scene.obstacle import Obstacle
from guidefield.scene.scene import Scene, placed_rows, rows_of, unplaced


class BufferLayout(NamedTuple):
    """Offset, type and length of each array in one buffer."""

    size: int  # of the buffer, in words of 64 bits
    offsets: Words  # as kernels take them: `lay_out` those of a world, `primitive_tables` those of a scene
    arrays: dict[str, tuple[int, Any, int]]  # by name: offset [bytes], type, length

    def views(self, memory: np.ndarray, begins: int) -> dict[str, np.ndarray]:
        """The arrays by their names, in a memory (size,) from where the first one begins [bytes]."""
        return {
            name: np.frombuffer(memory, kind, length, begins + offset)
            for name, (offset, kind, length) in self.arrays.items()
        }


@memoized
def scratch_layout(robot: BatchRobot, nv: int, own_pairs: int, obstacles: int) -> BufferLayout:
    """Lay out a world's scratch, configuration block and ignored pairs, for nv coordinates.

    The obstacles themselves are in `obstacle_tables_layout`.
    """
    poses, met = robot.joints.size * POSE, robot.bodies.size * obstacles
    lengths = {
        "poses": poses,
        "block": nv * LANES,
        "centres": robot.bodies.n_links * BLOCK,
        "places": (GRID_SIDES + 1) * LANES,
        "hits": HIT * HITS,
        "ignored": met,
        "found": FOUND * (met + own_pairs),  # each body near each obstacle, and each own pair, once
        "pose_a": 12,
        "pose_b": 12,
        "surface_a": 12,
        "surface_b": 12,
        "work": WORK,
        "middle": nv * LANES,
        "middle_poses": poses,
        "obstacle_axes": AXIS_AND_REACH * met,
        "pair_axes": AXIS_AND_REACH * robot.pieces_paired,
        "obstacle_places": 1 + met,
        "pair_places": 1 + robot.pieces_paired,
    }
    arrays, size = _one_after_another(lengths, BatchObstacles, Scratch, BatchWorld)
    offsets = [arrays[name][0] for name in ("ignored", *Scratch._fields, "block")]
    return BufferLayout(size, np.array(offsets, np.int64), arrays)


def obstacle_tables_layout(primitives: int, obstacles: int) -> BufferLayout:
    """Lay out the memory for the tables of a given number of primitives, with boxes for a given number of obstacles."""
    lengths = {
        "kinds": primitives,
        "whole": primitives,
        "roots": primitives,
        "ignored": 0,
        "primitives": PRIMITIVE * primitives,
        "boxes": -(-obstacles // LANES) * AROUND,
        "clouds": primitives,
        "balls": BALL_ROW * primitives,
        "links": LINK * primitives,
        "shapes": SHAPE * primitives,
        "numbers": PART * primitives,
        "vertices": BLOCK * primitives,
    }
    arrays, size = _one_after_another(lengths, BatchObstacles, Parts)
    offsets = [arrays[name][0] for name in (*BatchObstacles._fields[1:], *Parts._fields)]
    return BufferLayout(size, np.array([obstacles, *offsets], np.int64), arrays)


Arrays = dict[str, tuple[int, Any, int]]


@functools.cache
def _types_in(*layouts: type) -> dict[str, Any]:
    return {name: kind for layout in layouts for name, kind in array_types(layout).items()}


def _one_after_another(lengths: dict[str, int], *layouts: type) -> tuple[Arrays, int]:
    """Lay arrays one behind the other: offset [bytes], type and length of each, and the words of 64 bits of all."""
    kinds, arrays, end = _types_in(*layouts), {}, 0
    for name, length in lengths.items():
        arrays[name] = (end, kinds[name], length)
        end += -(-kinds[name].itemsize * length // LINE) * LINE
    return arrays, (end + LINE) // 8


MOST_SOLIDS = 512
"""A mesh of more solids is one tree of triangles, because each solid costs a millisecond before the first plan.

Its convex solids then have no inside for SIMD batches, as others never have: `clearance.find_enclosed_pair` alone
finds bodies wholly inside.
"""


class _Tables(NamedTuple):
    """The tables of one obstacle: k primitives that stand for it, and its parts."""

    # kind, whether the primitive is the obstacle itself, its root in the parts, and the address of a cloud's words or
    # 0, shape (k, 4)
    places: np.ndarray
    primitives: np.ndarray  # numbers of each, shape (k, PRIMITIVE), float32
    boxes: np.ndarray  # boxes about them along the world's axes, shape (k, 6) [m], float32
    parts: Parts


@dataclass(frozen=True, eq=False)
class BatchScene:
    """Obstacles for SIMD batches, primitives first."""

    owners: np.ndarray  # the obstacle of the scene that each primitive represents, shape (n,)
    # root of each obstacle of the scene in the parts, shape (o,); a cloud's is one ball at the origin
    roots: np.ndarray
    words: Words  # obstacles and parts, packed: valid as long as this is held
    made: Callable[[], tuple[BatchObstacles, Parts]]  # makes the same as arrays; holds their memory
    # that memory, and where in it the first array is [bytes]; None where there are others than primitives
    memory: tuple[np.ndarray, int] | None = None

    @cached_property
    def tables(self) -> tuple[BatchObstacles, Parts]:
        """The primitives, without allowed pairs, and the parts."""
        return self.made()


def _over(known: BatchScene, rows: Rows, scene: Scene) -> BatchScene | None:
    if known.memory is None or scene.others or not rows.in_place:
        return None
    memory, begins = known.memory
    layout = obstacle_tables_layout(len(known.owners), len(known.owners))
    moved = np.empty_like(memory)
    there = -moved.ctypes.data % LINE
    end = 8 * layout.size - LINE
    moved.view(np.uint8)[there : there + end] = memory.view(np.uint8)[begins : begins + end]
    views = layout.views(moved, there)
    for index in rows.fresh:
        if not _overwrite(views, index, *_primitives(rows_of([scene.obstacles[index]]), np.zeros(1, np.int64)).tables):
            return None
    moved.setflags(write=False)
    words = moved.ctypes.data + there + layout.offsets
    words[0] = known.words[0]
    return _in_memory(known.owners, words, layout, moved, there)


def _overwrite(views: dict[str, np.ndarray], index: int, one: BatchObstacles, parts: Parts) -> bool:
    """Write a primitive over another one in the tables of many; False if that is of another kind."""
    if views["kinds"][index] != one.kinds[0]:
        return False
    block, lane = divmod(index, LANES)
    views["boxes"][AROUND * block : AROUND * (block + 1)].reshape(-1, LANES)[:, lane] = one.boxes[::LANES]
    for name, array in {"primitives": one.primitives, "balls": parts.balls, "numbers": parts.numbers}.items():
        views[name].reshape(len(views["kinds"]), -1)[index] = array
    if one.kinds[0] == BOX:
        first = views["shapes"].reshape(-1, SHAPE)[index, FIRST_BLOCK]
        views["vertices"][BLOCK * first : BLOCK * (first + 1)] = parts.vertices
    return True


@incremental(_over)
def batch_scene(scene: Scene) -> BatchScene:
    """Build the tables of a scene's obstacles: primitives by a kernel, of the others those that are known by obstacle.

    Raises:
        UnsupportedShape: if a shape is of a kind that the kernels don't know.
    """
    placed, others = placed_rows(scene), unplaced(scene)
    owners = np.arange(len(placed))
    if not others:
        return _primitives(placed, owners)
    tables, kept = [_tables(scene.obstacles[index]) for index in others], np.delete(owners, others)
    owners = np.concatenate([kept, np.repeat(others, [len(table.places) for table in tables])])
    (obstacles, parts), table = _primitives(np.delete(placed, others, axis=0), owners).tables, PartsTable()
    if len(kept):  # else the parts of one mesh, which may be large, are not copied
        table.add_parts(parts)
    roots = np.empty(len(placed), np.int64)
    roots[kept], roots[others] = obstacles.roots, [table.add_parts(one.parts) for one in tables]
    made = _behind(obstacles, tables, roots[others]), table.tables()
    read_only(roots, *made[0][1:])
    return BatchScene(owners, roots, pack(made), lambda: made)


def _primitives(placed: np.ndarray, owners: np.ndarray) -> BatchScene:
    """Build the tables of primitives, rows as `primitive.PLACED` packs them; each is an obstacle."""
    layout = obstacle_tables_layout(len(placed), len(owners))
    memory, words = np.zeros(layout.size, np.int64), np.empty(SCENE_WORDS, np.int64)
    begins = primitive_tables(placed.ravel(), layout.offsets, memory, words)
    memory.setflags(write=False)
    return _in_memory(owners, words, layout, memory, begins)


def _in_memory(owners: np.ndarray, words: Words, layout: BufferLayout, memory: np.ndarray, begins: int) -> BatchScene:

    def make() -> tuple[BatchObstacles, Parts]:
        views = layout.views(memory, begins)
        obstacles = BatchObstacles(len(owners), *(views[name] for name in BatchObstacles._fields[1:]))
        return obstacles, Parts(**{name: views[name] for name in Parts._fields})

    read_only(owners)
    return BatchScene(owners, owners, words, make, (memory, begins))


def _behind(obstacles: BatchObstacles, tables: list[_Tables], roots: np.ndarray) -> BatchObstacles:
    """Join the tables of primitives and those of other obstacles, whose parts begin at given nodes, shape (k,)."""
    n = len(obstacles.kinds)
    places = np.concatenate([one.places for one in tables])
    places[:, 2] += np.repeat(roots, [len(one.places) for one in tables])
    index = np.arange(n, n + len(places))
    all_boxes = obstacles.boxes.copy()
    boxes = np.concatenate([one.boxes for one in tables])
    all_boxes.reshape(-1, 6, LANES)[index // LANES, :, index % LANES] = boxes
    return BatchObstacles(
        size=obstacles.size,
        kinds=np.concatenate([obstacles.kinds, places[:, 0]]),
        whole=np.concatenate([obstacles.whole, places[:, 1]]),
        roots=np.concatenate([obstacles.roots, places[:, 2]]),
        ignored=obstacles.ignored,
        primitives=np.concatenate([obstacles.primitives, *(one.primitives.ravel() for one in tables)]),
        boxes=all_boxes,
        clouds=np.concatenate([obstacles.clouds, places[:, 3]]),
    )


def prepare_scene(scene: Scene, deadline: Deadline, announce: Callable[[str], None] = lambda _: None) -> None:
    """Build and keep the tables of obstacles that aren't primitives, which takes seconds for large meshes.

    `announce` is called with the name of each before it is built. One that was begun is finished. Raises
    DeadlineExpired, with the obstacle's name, if time was up.
    """
    if scene in _prepared:
        return
    left = [one for one in map(scene.obstacles.__getitem__, unplaced(scene)) if _MADE.of(one, None) is MISSING]
    flat = [one for one in left if _is_flat(one)]
    for begin in range(0, len(flat), POLYGONS_AT_ONCE):
        announce(f"obstacle {flat[begin].name}")
        deadline.check(f"obstacle {flat[begin].name}")
        _make_flat(flat[begin : begin + POLYGONS_AT_ONCE])
    for obstacle in left:
        if _MADE.of(obstacle, None) is MISSING:
            announce(f"obstacle {obstacle.name}")
            deadline.check(f"obstacle {obstacle.name}")
            _tables(obstacle)
    _prepared.add(scene)


POLYGONS_AT_ONCE = 256  # polygons whose tables are made together, between two checks of the clock: some milliseconds
_prepared = MemoSet()

_MADE = Answers[_Tables]()  # tables of obstacles that are no primitives


def _tables(obstacle: Obstacle) -> _Tables:
    made = _MADE.of(obstacle, None)
    return _MADE.keep(obstacle, None, _tables_of(obstacle)) if made is MISSING else made


def parts_of(obstacle: Obstacle) -> Parts:
    """Return the convex parts of an obstacle that is no cloud, where it stands; the first node is about all."""
    if not obstacle.placed:
        return _tables(obstacle).parts
    table = PartsTable()
    table.add_shape(obstacle.shape, obstacle.placement)
    return table.tables()


def _is_flat(obstacle: Obstacle) -> bool:
    return isinstance(obstacle.message, messages.Polygon) and obstacle.faces <= MOST_TRIANGLES


def _make_flat(obstacles: Sequence[Obstacle]) -> list[_Tables]:
    made = flat_forest([np.take(*one.whole_surface, axis=0) for one in obstacles])  # which is in the world
    rows, places = (
        np.concatenate([flat.rows for flat in made]),
        _places_of(np.concatenate([flat.nodes for flat in made])),
    )
    numbers, boxes = rows.astype(np.float32), boxes_about(rows).astype(np.float32)
    begin, kept = 0, []
    for obstacle, flat in zip(obstacles, made, strict=True):
        own = slice(begin, begin + len(flat.nodes))
        kept.append(_MADE.keep(obstacle, None, _Tables(places[own], numbers[own], boxes[own], flat.parts)))
        begin = own.stop
    return kept


def _tables_of(obstacle: Obstacle) -> _Tables:
    if obstacle.cloud is None and obstacle.faces > MOST_TRIANGLES:
        made = large_surface(obstacle)
        parts = Parts(**{name: made[name] for name in Parts._fields})
        return _Tables(_places_of(made["nodes"]), made["primitives"], made["boxes"], parts)
    if _is_flat(obstacle):
        return _make_flat([obstacle])[0]
    table = PartsTable()
    places, rows = _stand_ins(obstacle, table)
    address = 0 if obstacle.cloud is None else obstacle.cloud.tables.address
    places = np.column_stack([places, np.full(len(places), address)])
    return _Tables(places, rows.astype(np.float32), boxes_about(rows).astype(np.float32), table.tables())


@memoized
def balls_of_cloud(obstacle: Obstacle) -> Parts:
    """Return the balls of a cloud as parts, in the world: the first node is about all of them."""
    assert obstacle.cloud is not None, "only clouds have grids"
    return cloud_parts(obstacle, obstacle.cloud)


def _stand_ins(obstacle: Obstacle, table: PartsTable) -> tuple[np.ndarray, np.ndarray]:
    """Return what represents an obstacle: kind, whether it is the obstacle itself, root, (k, 3); and numbers."""
    if obstacle.cloud is not None:
        return _cloud(obstacle.cloud, table)
    if obstacle.facets is not None:
        if obstacle.solid and 1 < len(obstacle.surfaces) <= MOST_SOLIDS:
            return _solids(obstacle, table)
        return _clusters(np.take(obstacle.vertices, obstacle.triangles, axis=0), table)
    placement = obstacle.placement
    root = table.add_shape(obstacle.shape, placement)
    low, high = obstacle.box
    middle = placement.act(0.5 * (low + high))
    return np.array([(BOX, False, root)], np.int64), _row(placement.rotation.T, middle, 0.5 * (high - low))[None]


def _cloud(cloud: Cloud, table: PartsTable) -> tuple[np.ndarray, np.ndarray]:
    """Represent a cloud by one ball at the origin, with the numbers of the box about all its balls."""
    low, high = cloud.box[0] - cloud.radius, cloud.box[1] + cloud.radius
    root = table.add_shape(coal.Sphere(cloud.radius), pin.SE3.Identity())
    row = _row(np.eye(3), 0.5 * (low + high), 0.5 * (high - low))
    return np.array([(CLOUD, True, root)], np.int64), row[None]


def _solids(obstacle: Obstacle, table: PartsTable) -> tuple[np.ndarray, np.ndarray]:
    """Represent each solid of a mesh: a convex one is a part with a box about it, another one a tree of triangles."""
    corners, boxes = [np.take(obstacle.vertices, part, axis=0) for _, part, _ in obstacle.surfaces], obstacle.boxes
    hulls = [
        vertices[np.unique(part)] if box is not None else _hull_of(*np.unique(part, return_inverse=True), vertices)
        for (vertices, part, _), box in zip(obstacle.surfaces, boxes, strict=True)
    ]
    trees = [mesh_tree(some) if hull is None else None for some, hull in zip(corners, hulls, strict=True)]
    sizes = [1 if tree is None else len(tree.balls) for tree in trees]
    roots = len(corners) - 1 + np.cumsum([0, *sizes[:-1]])
    table.add_above(*tree_above(corners, roots))
    places, rows = list[np.ndarray](), list[np.ndarray]()
    for some, hull, tree, box, root in zip(corners, hulls, trees, boxes, roots.tolist(), strict=True):
        if tree is not None:
            table.add_tree(tree)
            nodes, members = tree.clusters[CLUSTER]
        elif hull is not None:
            table.add_hull(transform_points(obstacle.placement, hull))
            nodes, members = np.zeros(1, np.int64), np.arange(len(some))[None]
        places.append(_places_of(root + nodes)[:, :3])
        if box is None:
            rows.append(cluster_rows(some, members))
        else:
            there = obstacle.placement * pin.SE3(box.rotation, box.centre)
            places[-1][:, 1] = True
            rows.append(_row(there.rotation.T, there.translation, box.halves)[None])
    return np.concatenate(places), np.concatenate(rows)


def _hull_of(used: np.ndarray, rows: np.ndarray, vertices: np.ndarray) -> np.ndarray | None:
    hull = own_hull(vertices[used], rows.reshape(-1, 3))
    return None if hull is None else np.array(hull.points())


def _clusters(corners: np.ndarray, table: PartsTable) -> tuple[np.ndarray, np.ndarray]:
    """Represent triangles (t, 3, 3) by boxes about neighbours, along the axes in which their corners spread.

    The roots are nodes of one tree over all triangles, each above its box's triangles alone.
    """
    tree = mesh_tree(corners)
    root = table.add_tree(tree)
    nodes, members = tree.clusters[CLUSTER]
    if len(corners) == 1:
        nodes, members = np.zeros(1, np.int64), np.zeros((1, 1), np.int64)
    return _places_of(root + nodes)[:, :3], cluster_rows(corners, members)


def _places_of(nodes: np.ndarray) -> np.ndarray:
    """Return the places of boxes about what is below nodes (k,), as `_Tables` has them."""
    none = np.zeros(len(nodes), np.int64)
    return np.column_stack([np.full(len(nodes), BOX), none, nodes, none])


def _row(axes: np.ndarray, centre: np.ndarray, halves: Any, radius: float = 0.0) -> np.ndarray:
    row = np.empty(PRIMITIVE)
    row[:CENTRE], row[CENTRE:HALVES], row[HALVES:ROUND], row[ROUND] = axes.ravel(), centre, halves, radius
    return row
