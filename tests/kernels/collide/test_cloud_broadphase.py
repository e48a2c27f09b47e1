"""Clouds in lanes: the tree and the grid against distances to every point, for clouds of all sizes."""

import numpy as np
import pytest
from numba import njit

from guidefield.kernels.collide.broadphase import cloud_near
from guidefield.kernels.distance.point_tree import cloud_of, nearest_distance, next_block
from guidefield.kernels.simd.packing import pointers
from guidefield.kernels.simd.vector import splat
from guidefield.messages import scene as messages
from guidefield.scene.cloud import CloudTables
from guidefield.scene.obstacle import build

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
