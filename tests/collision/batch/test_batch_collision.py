"""Batches against Coal: never free where it touches, and no further from it than the stated band; motions."""

import functools
import itertools

import numpy as np
import pytest

from guidefield.collision.batch.batch_collision import BatchCollision
from guidefield.collision.clearance import clearance_at
from guidefield.collision.world import World
from guidefield.geometry import surfaces
from guidefield.kernels.collide.layout import BAND
from guidefield.messages import scene as messages
from guidefield.robot.group.group import PlanningGroup
from guidefield.scene.scene import Scene, build
from guidefield.stores import scenes
from tests.robots import group

COUNTS = {"panda": 800, "ur5": 800, "kinova": 100}
"""Configurations for each scene; Coal is slow on the large meshes of the last."""

ROBOTS = tuple(COUNTS)
TURN = (0.1825742, 0.3651484, 0.5477226, 0.7302967)


def torus(rings: int = 12, sides: int = 8) -> tuple[list, list]:
    """A mesh that isn't convex."""
    u, v = np.meshgrid(np.arange(rings) * 2 * np.pi / rings, np.arange(sides) * 2 * np.pi / sides, indexing="ij")
    points = np.stack(
        [(0.2 + 0.07 * np.cos(v)) * np.cos(u), (0.2 + 0.07 * np.cos(v)) * np.sin(u), 0.07 * np.sin(v)], -1
    )
    triangles = []
    for i in range(rings):
        for j in range(sides):
            a, b, c, d = (x % rings * sides + y % sides for x, y in ((i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)))
            triangles += [(a, b, c), (a, c, d)]
    return points.reshape(-1, 3).tolist(), triangles


@functools.cache
def zoo() -> Scene:
    """Every kind of obstacle, oblique where it can be, around a robot's base."""
    vertices, triangles = torus()
    pointed = surfaces.box((0.15, 0.2, 0.1))
    obstacles = [
        messages.Box(name="box", size=(0.2, 0.3, 0.1), position=(0.5, 0.2, 0.5), quaternion_xyzw=TURN),
        messages.Cylinder(name="can", radius=0.08, length=0.3, position=(-0.4, 0.3, 0.4), quaternion_xyzw=TURN),
        messages.Sphere(name="ball", radius=0.12, position=(0.1, -0.5, 0.6)),
        messages.Capsule(name="pill", radius=0.06, length=0.3, position=(-0.4, -0.4, 0.6), quaternion_xyzw=TURN),
        messages.Mesh(name="ring", vertices=vertices, triangles=triangles, position=(0.1, 0.1, 1.1)),
        messages.Mesh(
            name="hull",
            vertices=pointed[0].tolist(),
            triangles=[tuple(row) for row in pointed[1].tolist()],
            position=(0.5, -0.4, 0.3),
            quaternion_xyzw=TURN,
        ),
        messages.Polygon(name="wall", vertices=[(0.7, -0.3, 0.2), (0.7, 0.3, 0.2), (0.6, 0.3, 0.9), (0.6, -0.3, 0.9)]),
        messages.HalfSpace(name="floor", normal=(0.1, 0.0, 1.0), offset=-0.2),
    ]
    return build(messages.Scene(name="zoo", obstacles=obstacles))


@functools.cache
def world_of(robot: str, scene: str) -> tuple[World, BatchCollision]:
    world = World.build(group(robot), zoo() if scene == "zoo" else build(scenes.read_packaged(scene)))
    return world, BatchCollision.build(world)


def draw(planned: PlanningGroup, count: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.array([planned.to_local(planned.random(rng)) for _ in range(count)])


def narrowest(world: World, z: np.ndarray) -> float:
    """Smallest signed distance of all pairs."""
    clearance = clearance_at(world, world.group.expand_from_local(z))
    return min(clearance.obstacle_distance, clearance.self_distance)


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("scene", ["zoo", "bookshelf", "wall_with_window"])
def test_touching_is_what_coal_says(robot: str, scene: str) -> None:
    """Some 5,000 configurations in all."""
    world, batch = world_of(robot, scene)
    zs = draw(world.group, COUNTS[robot], 2)
    mine = batch.touching(zs)
    coal = np.array([world.in_collision(world.group.expand_from_local(z)) for z in zs])
    assert 0 < coal.sum() < len(zs)
    for z in zs[mine != coal]:
        assert abs(narrowest(world, z)) <= BAND


@pytest.mark.parametrize("robot", ROBOTS)
def test_close_to_contact_too(robot: str) -> None:
    """Where a motion into contact is halved down to a micrometre, both still agree but within the band."""
    world, batch = world_of(robot, "zoo")
    zs = draw(world.group, COUNTS[robot] // 4, 3)
    touching = np.array([world.in_collision(world.group.expand_from_local(z)) for z in zs])
    for free, hit in zip(zs[~touching][:30], zs[touching][: COUNTS[robot] // 50], strict=False):
        low, high = free, hit
        for _ in range(22):
            middle = 0.5 * (low + high)
            low, high = (low, middle) if world.in_collision(world.group.expand_from_local(middle)) else (middle, high)
        for z in np.linspace(0.0, 1.0, 41)[:, None] * (high - free) + free, low + np.linspace(-1e-5, 1e-5, 9)[:, None]:
            mine = batch.touching(z)
            coal = np.array([world.in_collision(world.group.expand_from_local(row)) for row in z])
            for row in z[mine != coal]:
                assert abs(narrowest(world, row)) <= BAND


def test_a_clearance_is_kept_from_obstacles_but_not_from_itself() -> None:
    world, batch = world_of("panda", "zoo")
    zs = draw(world.group, 600, 4)
    mine = batch.touching(zs, 0.05)
    for z, touches in zip(zs, mine, strict=True):
        clearance = clearance_at(world, world.group.expand_from_local(z))
        if min(abs(clearance.obstacle_distance - 0.05), abs(clearance.self_distance)) > BAND:
            assert touches == (clearance.obstacle_distance < 0.05 or clearance.self_distance < 0.0)


def test_sixteen_samples_at_once_are_as_one_by_one() -> None:
    world, batch = world_of("panda", "zoo")
    zs = draw(world.group, 300, 5)
    for z0, far in itertools.pairwise(zs):
        z1 = z0 + 0.1 * (far - z0)
        blocks = max(1, int(np.ceil(np.linalg.norm(z1 - z0) * 32.0 / 16)))
        samples = z0 + np.arange(1, 16 * blocks + 1)[:, None] / (16 * blocks) * (z1 - z0)
        assert bool(batch.free_until(np.array([z0, z1]), 32.0)) == (not batch.touching(samples).any())


def test_a_shortened_path_is_free_where_it_was_and_no_longer() -> None:
    world, batch = world_of("panda", "zoo")
    zs = draw(world.group, 400, 10)
    zs = zs[~batch.touching(zs)]
    ways = [zs[0]]
    for z in zs[1:]:  # a roundabout way of free motions
        if batch.free_until(np.array([ways[-1], z]), 32.0):
            ways.append(z)
    path = np.array(ways[:9])
    assert len(path) == 9
    short = batch.shorten(path, 32.0)
    np.testing.assert_array_equal(short[[0, -1]], path[[0, -1]])
    assert batch.free_until(short, 32.0) == len(short) - 1
    before, after = (np.linalg.norm(np.diff(way, axis=0), axis=1).sum() for way in (path, short))
    assert after < 0.9 * before
    np.testing.assert_array_equal(short, batch.shorten(path, 32.0))
