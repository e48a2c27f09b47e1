"""Clouds in SIMD batches against every point, and the fast judgement of motions against Coal."""

import numpy as np
import pytest
from numba import njit

from guidefield.collision.world import World
from guidefield.kernels.collide.broadphase import cloud_near
from guidefield.kernels.distance.point_tree import cloud_of, nearest_distance, next_block
from guidefield.kernels.simd.packing import pointers
from guidefield.kernels.simd.vector import splat
from guidefield.messages import scene as messages
from guidefield.planner.guide.guided_path import swept_world
from guidefield.prove.certificate import motion_free
from guidefield.scene.cloud import CloudTables
from guidefield.scene.obstacle import build
from tests.planner.problems import library_scene, scene_of
from tests.robots import box_arm, group, grouped, rest

RADIUS = 0.01
SIZES = (1, 2, 15, 16, 17, 255, 257, 4097, 66_000)


@njit
def _queries(words, points, reach, nearest, blocks, near):
    cloud = cloud_of(pointers(words))
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        nearest[i] = nearest_distance(cloud, x, y, z)
        found, block = 0, next_block(cloud, -1, x, y, z, reach)
        while block >= 0:
            found, block = found + 1, next_block(cloud, block, x, y, z, reach)
        blocks[i] = found
        x, y, z = splat(x), splat(y), splat(z)
        near[i] = cloud_near(cloud, x, y, z, reach, 0b101)


def cloud(count: int) -> tuple[np.ndarray, CloudTables]:
    """Points in a box and on a plane, some of them twice, and their tables."""
    rng = np.random.default_rng(count)
    points = rng.uniform(-0.5, 0.5, (count, 3))
    points[: count // 2, 2] = 0.2
    points[count // 2 : count // 2 + count // 8] = points[: count // 8]
    points = points.astype(np.float32).astype(float)
    rows = [tuple(point) for point in points.tolist()]
    cloud = build(messages.PointCloud(name="scan", points=rows, radius=RADIUS), 0).cloud
    return points, cloud.tables


@pytest.mark.parametrize("count", SIZES)
def test_what_is_near_is_what_distances_say(count: int) -> None:
    points, found = cloud(count)
    rng = np.random.default_rng(1)
    places = np.concatenate([rng.uniform(-0.8, 0.8, (150, 3)), rng.uniform(-9.0, 9.0, (10, 3)), points[:20]])
    exact = np.array([np.linalg.norm(points - place, axis=1).min() for place in places])
    nearest, blocks, near = np.zeros(len(places)), np.zeros(len(places), int), np.zeros(len(places), int)
    for reach in (0.003, 0.04, 0.3):
        for _ in range(2):  # cells of the grid are found, then known
            _queries(found.words, places, reach, nearest, blocks, near)
            assert nearest == pytest.approx(exact, abs=1e-6)
            clear = abs(exact - reach) > 1e-6
            assert ((blocks > 0) == (exact < reach))[clear].all()
            clear = abs(exact - reach - RADIUS) > 1e-6
            assert (near == np.where(exact < reach + RADIUS, 0b101, 0))[clear].all()
    held = found.tables.points.reshape(-1, 3, 16)
    some = ((held - places[0][:, None]) ** 2).sum(axis=1).min(axis=1) < 0.3**2
    assert blocks[0] == some.sum()


MARGIN = 2e-3


def motions(planned, count: int, seed: int) -> list[tuple[np.ndarray, np.ndarray]]:
    rng = np.random.default_rng(seed)
    origin = planned.to_local(rest(planned))
    pairs = []
    for _ in range(count):
        z0 = origin + rng.normal(size=planned.nv) * rng.choice([0.05, 0.3])
        pairs.append((z0, z0 + rng.normal(size=planned.nv) * rng.choice([0.02, 0.1])))
    return pairs


@pytest.mark.parametrize(
    ("name", "scene"),
    [
        ("chain_fixed_6x300_r25", "seed_a_gates"),
        ("chain_moving_3x260_r25", "seed_e_L_3"),
        ("chain_moving_6x200_r20", "seed_d_passage_6"),
        ("chain_universal_fixed_6x320_r25", "seed_c_blocked"),
        ("panda", "bookshelf"),
        ("ur5", "table"),
    ],
)
def test_a_yes_is_coals_yes(name: str, scene: str) -> None:
    planned = group(name)
    world = World.build(planned, library_scene(scene))
    swept = swept_world(world)
    agreed = 0
    for z0, z1 in motions(planned, 40, 1):
        fast, judged = swept.apart(z0, z1, MARGIN), motion_free(world, z0, z1, MARGIN).free
        assert judged or not fast
        agreed += fast == judged
    if swept.exact:
        assert agreed >= 38
    assert swept.exact == name.startswith("chain")


@pytest.mark.parametrize(
    "joints",
    ["x slide oblique", "continuous oblique-continuous y", "x mimic slide", "planar x y", "continuous screw half-gear"],
)
def test_every_kind_of_joint_is_bounded(joints: str) -> None:
    planned = grouped(box_arm(joints, 0))
    ball = messages.Sphere(name="ball", radius=0.2, position=(0.35, 0.1, 0.6))
    world = World.build(planned, scene_of(ball, messages.HalfSpace(name="floor", normal=(0, 0, 1), offset=-0.2)))
    swept = swept_world(world)
    yes = 0
    for z0, z1 in motions(planned, 40, 2):
        if swept.apart(z0, 3.0 * z1 - 2.0 * z0, MARGIN):
            yes += 1
            assert motion_free(world, z0, 3.0 * z1 - 2.0 * z0, MARGIN).free
    assert yes >= 3


def test_a_motion_through_an_obstacle_between_free_ends_is_refused() -> None:
    planned = group("chain_fixed_6x300_r25")
    post = messages.Box(name="post", size=(0.01, 0.01, 2.0), position=(0.9, 0.0, 0.0))
    swept = swept_world(World.build(planned, scene_of(post)))
    before, after = np.zeros(planned.nv), np.zeros(planned.nv)
    before[2], after[2] = -0.4, 0.4
    assert swept.apart(before, before, MARGIN)
    assert swept.apart(after, after, MARGIN)
    assert not swept.apart(before, after, MARGIN)
