"""Check the tables that searches and batches ask: each node, sphere and box holds all that its body has below it.

What the bodies are is told by the referee, which reads robot and scene in its own way.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np
import pinocchio as pin

from doubting.scenery import KINDS, make_fly, obstacle as random_obstacle
from guidefield.case_file import Motion, make_cases
from guidefield.collision.batch.scene_tables import batch_scene
from guidefield.collision.bodies import bodies
from guidefield.collision.obstacle_boxes import obstacle_boxes
from guidefield.collision.world import World
from guidefield.kernels.collide.parts import LINK
from guidefield.kernels.distance.point_tree import BatchCloud
from guidefield.kernels.prove.kept_distance import LOG_ROW, ROW_A, ROW_AXIS, ROW_B, ROW_PAIR, ROW_SEGMENT
from guidefield.kernels.simd.vector import LANES
from guidefield.messages import scene as messages
from guidefield.messages.values import Placement
from guidefield.prove.proof import _Writer
from guidefield.prove.search import SearchQuery
from guidefield.prove.tables import obstacle_bodies, world_tables
from guidefield.referee.case import Body
from guidefield.referee.judge import Along
from guidefield.referee.loading import case_of
from guidefield.referee.proof import box_about, declared, radius_about
from guidefield.referee.replay import _Replay
from guidefield.robot.group.reduced_model import select
from guidefield.robot.model.model import RobotModel
from guidefield.scene.distance_tables import distance_tables
from guidefield.scene.scene import Scene, build

SINGLE = 1e-6
"""Distance by which a mesh that Assimp reads in single precision may stand out, for each metre of its size [m]."""


def check_tables(world: World) -> dict[str, float]:
    """Measure how far each moving link and each obstacle stands out of its nodes, as a share of 1 m and its size.

    It is infinite where a triangle is in no leaf, and there is nothing where no link moves that has a shape. Every node
    is put into a slab, once by its sphere and once by its part: so the referee asks of each triangle whether it is in a
    leaf and in all that holds this one.

    Args:
        world: The robot among at least one obstacle.
    """
    tables = world_tables(world, in_time=False)
    robot, obstacles, pairs = tables.robot, tables.obstacles, tables.pairs
    first, count, rows = len(pairs.own), len(obstacles.roots), list[np.ndarray]()
    for row, body in enumerate(pairs.moving.tolist()):
        nodes = _below(robot.parts.links, int(robot.roots[body]))
        rows.append(_rows(first + row * count, nodes, np.full(len(nodes), obstacles.roots[0])))
    for index, root in enumerate(obstacles.roots.tolist() if len(pairs.moving) else ()):
        nodes = _below(obstacles.parts.links, root)
        rows.append(_rows(first + index, np.full(len(nodes), robot.roots[pairs.moving[0]]), nodes))
    if not rows:
        return {}
    straight = np.outer([0.0, 1e-6], np.ones(world.group.nv))
    motion = Motion(world, Placement(), (), None, straight, None)
    proof = _Writer(world, SearchQuery(0.0), np.concatenate(rows)).proof(np.empty((0, 4)), np.array([[0.0, 1.0, 0.5]]))
    case = case_of(make_cases(motion)[0])
    out = _Replay(case, proof, Along(case, 0.0, 0.0, math.inf))._slabs.standing_out
    found: dict[str, float] = {}
    for one, far in zip(case.bodies, out.tolist(), strict=True):
        found[one.name] = max(found.get(one.name, 0.0), far / (1.0 + float(np.ptp(one.corners, axis=0).max())))
    return found


def robot_alone(robot: RobotModel) -> World:
    """A robot with all its joints, far from the one thing that stands in its world."""
    far = messages.Box(name="far away", size=(1.0, 1.0, 1.0), position=(0.0, 0.0, -1e3))
    group = select(robot, None, None, robot.rest, pin.SE3.Identity())
    return World.build(group, build(messages.Scene(name="alone", obstacles=[far])))


def _below(links: np.ndarray, root: int) -> np.ndarray:
    """A node and all below it."""
    table, found, waiting = links.reshape(-1, LINK)[:, :2], [], np.array([root])
    while len(waiting):
        found.append(waiting)
        waiting = table[waiting].ravel()
        waiting = waiting[waiting >= 0]
    return np.concatenate(found)


def _rows(pair: int, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Slabs between nodes of a pair (n,), by their spheres and by their parts, as a search writes them down."""
    rows = np.zeros((2, len(first), LOG_ROW))
    rows[..., ROW_SEGMENT], rows[..., ROW_PAIR] = 1.0, pair
    rows[..., ROW_A], rows[..., ROW_B], rows[1, :, ROW_AXIS] = first, second, 1.0
    return rows.reshape(-1, LOG_ROW)


Corners = tuple[np.ndarray, np.ndarray]  # lower and upper corner of a box or of many, shape (3,) or (n, 3) [m]
Found = Iterator[tuple[str, float]]  # what a bound is about, and how far it stands out of the bound [m]


def check_bounds(world: World) -> dict[str, float]:
    """Measure how far each link, obstacle and node of a tree stands out of a bound, as a share of 1 m and its size.

    It is infinite where an obstacle is in no leaf of a tree, or in more than one.
    """
    still = np.outer([0.0, 1e-6], np.ones(world.group.nv))
    case, found = case_of(make_cases(Motion(world, Placement(), (), None, still, None))[0]), dict[str, float]()
    parent_joints = [str(world.model.names[joint]) for joint in bodies(world.group).joints.tolist()]
    links = [  # not those of joints that this robot's model has no more
        one for one in case.bodies if not one.obstacle and case.model.names[one.joint] in parent_joints
    ]
    obstacles = {one.name: one for one in case.bodies if one.obstacle}
    size = {one.name: 1.0 + float(np.ptp(one.corners, axis=0).max(initial=0.0)) for one in case.bodies}
    checks = (
        _by_spheres(world, links),
        _by_boxes(world.scene, obstacles),
        _by_batch_boxes(world.scene, obstacles),
        _by_distance_boxes(world.scene, obstacles),
        _in_trees(world.scene),
        *(_in_cloud(one.name, one.cloud.tables.tables, one.cloud.points) for one in world.scene.obstacles if one.cloud),
    )
    for name, out in (one for check in checks for one in check):
        found[name] = max(found.get(name, 0.0), out / size.get(name, 1.0))
    return found


def random_scene(rng: np.random.Generator, rounds: int = 3) -> Scene:
    """Obstacles of every kind, some of which move, and a cloud of many points."""
    some = list[messages.Obstacle]()
    for k, kind in enumerate(rounds * (*KINDS, "ground")):
        at = 2.0 * rng.normal(size=3)
        one = random_obstacle(rng, kind, f"{kind} {k}", at, 0.5)
        some.append(make_fly(rng, one, at, 0.5, 2.0) if k % 5 == 4 and kind != "half_space" else one)
    many = rng.normal(size=(int(rng.integers(300, 6000)), 3)).tolist()
    some.append(messages.PointCloud(name="many points", points=many, radius=0.02))
    return build(messages.Scene(name="random", obstacles=some))


def _by_spheres(world: World, links: list[Body]) -> Found:
    """Each link's shapes in its sphere, and their points, and middles of them, in one of its smaller spheres."""
    about, rng, free = bodies(world.group), np.random.default_rng(len(links)), set(range(len(world.body_names)))
    for one in links:
        here, back = declared(one), one.placement.inverse()
        chosen = here.points[here.items[rng.integers(len(here.items), size=200)]]
        shares = rng.dirichlet(np.ones(chosen.shape[1]), len(chosen))
        points = np.concatenate([here.points, np.einsum("nk,nkc->nc", shares, chosen)])
        out = {}
        for row in (row for row in free if world.body_names[row] == one.name):
            middles = (about.part_centres[row] - one.placement.translation) @ one.placement.rotation
            apart = np.linalg.norm(points[:, None] - middles, axis=2).min(axis=1).max() - about.part_radii[row]
            out[row] = max(radius_about(here, back.act(about.centres[row])) - about.radii[row], float(apart))
        nearest = min(out, key=lambda row: abs(out[row]))  # shapes of a link stand in any order
        free.remove(nearest)
        yield one.name, out[nearest]


def _placed(one: Body) -> tuple[np.ndarray, np.ndarray]:
    """Return where an obstacle is at first: rotation and translation."""
    at = one.placement if one.screw is None else one.screw.stops[0] * one.placement
    return at.rotation, at.translation


def _in_world(one: Body) -> Corners:
    return box_about(declared(one), *_placed(one))


def _beyond(inner: Corners, outer: Corners) -> np.ndarray:
    """Return how far boxes stand out of others [m]."""
    with np.errstate(invalid="ignore"):  # boxes of nothing, in others of nothing
        out: np.ndarray = np.nan_to_num(np.maximum(outer[0] - inner[0], inner[1] - outer[1]), nan=0.0, posinf=np.inf)
    return out.max(axis=-1)


def _by_boxes(scene: Scene, obstacles: Mapping[str, Body]) -> Found:
    """Each obstacle in its own box, and in its leaf of the tree; a half-space is in none."""
    for boxes in (obstacle_boxes(scene).tables, obstacle_bodies(scene, timed=True).boxes):
        leaves = boxes.order.tolist()
        for index, obstacle in enumerate(scene.obstacles):
            one, times = obstacles[obstacle.name], leaves.count(index) + boxes.apart.tolist().count(index)
            yield one.name, 0.0 if times == 1 else np.inf
            if declared(one).plane.any():
                yield one.name, 0.0 if np.isinf(boxes.halves[index]).any() else np.inf
                continue
            axes, (rotation, translation) = boxes.axes[index].reshape(3, 3), _placed(one)
            own = box_about(declared(one), axes.T @ rotation, axes.T @ translation)
            low, high = boxes.centres[index] - boxes.halves[index], boxes.centres[index] + boxes.halves[index]
            yield one.name, float(_beyond(own, (low, high)))
            if index in leaves:
                node = boxes.nodes[leaves.index(index)]
                yield one.name, float(_beyond(_in_world(one), (node[:3], node[3:])))


def _by_batch_boxes(scene: Scene, obstacles: Mapping[str, Body]) -> Found:
    """Each triangle or point of an obstacle, or the whole of a primitive, in a box of SIMD batches."""
    made = batch_scene(scene)
    boxes = made.tables[0].boxes.reshape(-1, 6, LANES).swapaxes(1, 2).reshape(-1, 6).astype(float)[: len(made.owners)]
    for index, obstacle in enumerate(scene.obstacles):
        one, mine = obstacles[obstacle.name], boxes[made.owners == index]
        here, (rotation, translation) = declared(one), _placed(one)
        if here.plane.any():
            continue
        if len(here.items) == 1 or here.disc or here.ball:
            whole = _in_world(one)
            yield one.name, float(_beyond(whole, (mine[:, :3].min(axis=0), mine[:, 3:].max(axis=0))))
            continue
        corners = (here.points @ rotation.T + translation)[here.items]
        low, high = corners.min(axis=1), corners.max(axis=1)
        yield one.name, float(np.min([_beyond((low, high), (box[:3], box[3:])) for box in mine], axis=0).max())


def _by_distance_boxes(scene: Scene, obstacles: Mapping[str, Body]) -> Found:
    """Each obstacle that rests in the boxes of its bodies for signed distances."""
    tables = distance_tables(scene)
    for index, obstacle in enumerate(scene.obstacles):
        if obstacle.motion is None and not declared(obstacles[obstacle.name]).plane.any():
            mine = tables.boxes[tables.obstacles == index]
            about = (mine[:, :3].min(axis=0, initial=np.inf), mine[:, 3:].max(axis=0, initial=-np.inf))
            yield obstacle.name, float(_beyond(_in_world(obstacles[obstacle.name]), about))


def _in_trees(scene: Scene) -> Found:
    """Each box of a tree in the one above it."""
    boxes, tables = obstacle_boxes(scene).tables, distance_tables(scene)
    for level in range(1, len(boxes.levels) - 1):
        below = boxes.nodes[boxes.levels[level - 1] : boxes.levels[level]]
        above = boxes.nodes[boxes.levels[level] + np.arange(len(below)) // boxes.children]
        yield "the tree of obstacles", float(_beyond(np.split(below, 2, axis=1), np.split(above, 2, axis=1)).max())
    if len(tables.nodes) > 1:
        below, above = tables.nodes[1:], tables.nodes[(np.arange(1, len(tables.nodes)) - 1) // 2]
        yield "the tree of distances", float(_beyond(np.split(below, 2, axis=1), np.split(above, 2, axis=1)).max())
    if len(tables.nodes):
        inside = tables.boxes[np.isfinite(tables.boxes).all(axis=1)]
        about = tables.nodes[0, :3], tables.nodes[0, 3:]
        yield "the tree of distances", float(_beyond(np.split(inside, 2, axis=1), about).max(initial=0.0))


def _in_cloud(name: str, cloud: BatchCloud, points: np.ndarray) -> Found:
    """Each point of a cloud among those of its tree, and below a box of each level that holds it."""
    kept = cloud.points.reshape(-1, 3, LANES).swapaxes(1, 2).reshape(-1, 3)[: len(points)].astype(float)
    order, given = (np.lexsort(some.astype(np.float32).T) for some in (kept, points))
    yield name, float(np.abs(kept[order] - points[given]).max(initial=0.0))
    boxes = cloud.boxes.reshape(-1, 6, LANES).swapaxes(1, 2).astype(float)
    place = np.arange(len(kept)) // LANES
    for level in range(1, cloud.levels + 1):
        about = boxes[cloud.firsts[level] + place // LANES, place % LANES]
        yield name, float(_beyond((kept, kept), (about[:, :3], about[:, 3:])).max(initial=0.0))
        place //= LANES
