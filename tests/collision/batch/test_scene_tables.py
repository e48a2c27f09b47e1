"""A scene as tables for SIMD batches: primitives, meshes of several solids, and clouds."""

import functools

import coal
import msgspec
import numpy as np
import pinocchio as pin
import pytest

from guidefield.collision.batch.batch_collision import BatchCollision
from guidefield.collision.batch.scene_tables import batch_scene, prepare_scene
from guidefield.collision.clearance import clearance_at, find_enclosed_pair
from guidefield.collision.world import World
from guidefield.deadline import UNLIMITED, Deadline, DeadlineExpired
from guidefield.geometry import surfaces
from guidefield.kernels.collide.layout import BAND
from guidefield.kernels.distance.winding import winding_by_angles
from guidefield.messages import scene as messages
from guidefield.messages.values import Float32Array
from guidefield.robot.link_charges import surface_points
from guidefield.robot.model.collision_shapes import triangulation
from guidefield.scene.scene import Scene, build
from tests.collision.batch.test_batch_collision import torus
from tests.collision.scenery import scattered
from tests.robots import group, random_configuration
from tests.scene.solids import box_mesh, l_prism, mesh_message, room

RING = messages.Mesh(
    name="ring",
    vertices=[(0.1, 0.0, 0.0), (0.0, 0.1, 0.0), (0.0, 0.0, 0.1), (-0.1, 0.0, 0.0), (0.0, 0.02, 0.02)],
    triangles=[(0, 1, 2), (1, 3, 2), (0, 4, 1)],
    position=(0.4, 0.4, 0.4),
)
WALL = messages.Polygon(name="wall", vertices=[(0.7, -0.3, 0.2), (0.7, 0.3, 0.2), (0.6, 0.3, 0.9), (0.6, -0.3, 0.9)])
FLOOR = messages.HalfSpace(name="floor", normal=(0.1, 0.0, 1.0), offset=-0.2)
LEVEL = messages.HalfSpace(name="level", normal=(0.0, 0.0, 2.0), offset=-0.4)


def scene(seed: int, count: int) -> Scene:
    """Primitives with something else before, among and behind them."""
    obstacles = scattered(np.random.default_rng(seed), count)
    obstacles = [RING, *obstacles[: count // 2], FLOOR, WALL, LEVEL, *obstacles[count // 2 :]]
    return build(messages.Scene(name="test", obstacles=obstacles))


def test_preparing_a_scene_stops_when_time_is_up_and_goes_on_later() -> None:
    solids = [
        msgspec.structs.replace(mesh_message(*l_prism(), position=(0.41, 0.13, 0.07 + k)), name=f"m{k}")
        for k in range(3)
    ]
    made = build(messages.Scene(name="s", obstacles=solids))
    for at, left in (("m0", 1), ("m0", 1), ("m1", 2), ("m2", 2)):
        answers = iter([False] * (left - 1) + [True])
        with pytest.raises(DeadlineExpired, match=f"^obstacle {at}$"):
            prepare_scene(made, Deadline(is_cancelled=lambda answers=answers: next(answers)))
    prepare_scene(made, UNLIMITED)
    prepare_scene(made, Deadline(0.0))  # nothing is left to do
    assert len(batch_scene(made).owners) > 0


Mesh = tuple[np.ndarray, np.ndarray]


def moved(mesh: Mesh, scale: object, place: object) -> Mesh:
    return np.asarray(mesh[0], float) * scale + place, np.asarray(mesh[1])


@functools.cache
def solids() -> dict[str, Mesh]:
    """Boards that share corners and edges, as those of a shelf do; a ball, an L, a hollow box, a ring."""
    ball = surfaces.sphere(0.1, subdivisions=2)
    points, triangles = torus()
    return {
        "side": moved(box_mesh(), (0.25, 0.125, 0.5), (0.625, -0.3125, 0.5)),
        "shelf": moved(box_mesh(), (0.25, 0.5, 0.125), (0.625, 0.0, 0.8125)),
        "corner": moved(box_mesh(), (0.125, 0.125, 0.125), (0.8125, -0.4375, 0.1875)),
        "ball": moved((ball.vertices, ball.triangles), 1.0, (0.2, 0.5, 0.6)),
        "bend": moved(l_prism(), 0.125, (-0.5, 0.25, 0.25)),
        "room": moved(room(0.5, 0.375), 1.0, (-0.5, -0.5, 0.5)),
        "ring": moved((np.array(points), np.array(triangles)), 1.0, (0.1, 0.1, 1.1)),
    }


@functools.cache
def scenes() -> tuple[Scene, Scene]:
    """All solids as one mesh, and each as a mesh of its own."""
    meshes = list(solids().values())
    firsts = np.cumsum([0, *(len(vertices) for vertices, _ in meshes[:-1])])
    triangles = np.concatenate([rows + first for (_, rows), first in zip(meshes, firsts, strict=True)])
    one = mesh_message(np.concatenate([vertices for vertices, _ in meshes]), triangles, name="all")
    each = [mesh_message(*mesh, name=name) for name, mesh in solids().items()]
    return build(messages.Scene(name="one", obstacles=[one])), build(messages.Scene(name="each", obstacles=each))


@pytest.mark.parametrize("robot", ["panda", "ur5"])
def test_a_robot_touches_one_mesh_where_it_touches_its_solids(robot: str) -> None:
    planned = group(robot)
    zs = np.array([planned.to_local(random_configuration(planned, seed)) for seed in range(400)])
    one, each = (BatchCollision.build(World.build(planned, scene)) for scene in scenes())
    for clearance in (0.0, 0.03):
        first, second = one.touching(zs, clearance), each.touching(zs, clearance)
        assert 20 < second.sum() < 380
        # within a convex solid a body touches it; surfaces alone leave what is wholly inside to `enclosure`
        assert not (second & ~first).any()
        assert (first & ~second).sum() <= 2


RADIUS = 0.008
SHELF = [
    ((0.5, 0.9, 0.02), (0.6, 0.0, 0.25)),
    ((0.5, 0.9, 0.02), (0.6, 0.0, 0.75)),
    ((0.5, 0.02, 0.7), (0.6, 0.4, 0.5)),
]


def scan(spacing: float) -> np.ndarray:
    """Points of a shelf."""
    boards = [(surfaces.box(size), position) for size, position in SHELF]
    return np.concatenate([surface_points(*board, spacing).points + position for board, position in boards])


def packed(name: str, points: np.ndarray, radius: float = RADIUS) -> messages.PointCloud:
    return messages.PointCloud(name=name, points=Float32Array(points.astype("<f4").tobytes()), radius=radius)


@functools.cache
def world_of(robot: str) -> tuple[World, BatchCollision]:
    """A robot among two clouds and other obstacles."""
    few = np.random.default_rng(0).normal(size=(40, 3)) * 0.2 + (-0.4, 0.3, 0.6)
    obstacles = [packed("shelf", scan(0.02)), *scattered(np.random.default_rng(1), 4), packed("dust", few, 0.02)]
    world = World.build(group(robot), build(messages.Scene(name="scans", obstacles=obstacles)))
    return world, BatchCollision.build(world)


def draw(world: World, count: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.array([world.group.to_local(world.group.random(rng)) for _ in range(count)])


def narrowest(world: World, z: np.ndarray) -> float:
    """Smallest distance of all pairs."""
    clearance = clearance_at(world, world.group.expand_from_local(z))
    return min(clearance.obstacle_distance, clearance.self_distance)


@pytest.mark.parametrize("robot", ["panda", "ur5"])
def test_touching_is_what_coal_says(robot: str) -> None:
    world, batch = world_of(robot)
    zs = draw(world, 1000, 2)
    mine = batch.touching(zs)
    by_coal = np.array([world.in_collision(world.group.expand_from_local(z)) for z in zs])
    assert 0.2 < by_coal.mean() < 0.9
    for z in zs[mine & ~by_coal]:  # Coal sees a link's surface: a ball may be wholly inside
        assert narrowest(world, z) <= BAND or find_enclosed_pair(world, world.group.expand_from_local(z)) is not None
    assert not (by_coal & ~mine).any()


@pytest.mark.parametrize("robot", ["panda", "ur5"])
def test_close_to_contact_too(robot: str) -> None:
    """Where a motion into contact is halved down to a micrometre, both still agree but within the band."""
    world, batch = world_of(robot)
    zs = draw(world, 300, 3)
    touching = np.array([world.in_collision(world.group.expand_from_local(z)) for z in zs])
    for free, hit in zip(zs[~touching], zs[touching][:12], strict=False):
        low, high = free, hit
        for _ in range(22):
            middle = 0.5 * (low + high)
            low, high = (low, middle) if world.in_collision(world.group.expand_from_local(middle)) else (middle, high)
        rows = np.concatenate([np.linspace(free, hit, 41), low + np.linspace(-1e-5, 1e-5, 9)[:, None]])
        mine = batch.touching(rows)
        by_coal = np.array([world.in_collision(world.group.expand_from_local(row)) for row in rows])
        assert not (by_coal & ~mine).any() or max(narrowest(world, row) for row in rows[by_coal & ~mine]) <= BAND
        for row in rows[mine & ~by_coal]:
            assert (
                narrowest(world, row) <= BAND
                or find_enclosed_pair(world, world.group.expand_from_local(row)) is not None
            )


def test_a_clearance_is_kept() -> None:
    world, batch = world_of("panda")
    zs = draw(world, 300, 6)
    for z, touches in zip(zs, batch.touching(zs, 0.05), strict=True):
        clearance = clearance_at(world, world.group.expand_from_local(z))
        if min(abs(clearance.obstacle_distance - 0.05), abs(clearance.self_distance)) > BAND:
            assert touches == (clearance.obstacle_distance < 0.05 or clearance.self_distance < 0.0)


def test_a_point_inside_a_link_is_told_though_it_touches_nothing() -> None:
    """Coal judges some of the links of a UR5 as surfaces."""
    planned, rng = group("ur5"), np.random.default_rng(9)
    q = planned.random(rng)
    data = planned.model.createData()
    pin.forwardKinematics(planned.model, data, planned.expand(q))
    told = 0
    for shape in planned.geometry.geometryObjects:
        if not (isinstance(shape.geometry, coal.BVHModelBase) and shape.parentJoint):
            continue
        vertices, triangles = map(np.array, triangulation(shape.geometry))
        local = rng.uniform(vertices.min(axis=0), vertices.max(axis=0), (40, 3))
        inside = [abs(winding_by_angles(*point.tolist(), vertices, triangles)) > 0.5 for point in local]
        for point in local[inside][:3]:
            there = data.oMi[shape.parentJoint].act(shape.placement.act(point))
            dots = np.array([there, [9.0, 9.0, 9.0]])
            world = World.build(planned, build(messages.Scene(name="s", obstacles=[packed("dots", dots, 1e-5)])))
            found = find_enclosed_pair(world, q)
            assert world.in_collision(q) or (found is not None and found[1] == "dots")
            told += found is not None
    assert told > 0
