"""Clouds on lanes against Coal: never free where it touches, and no further from it than the stated band."""

from __future__ import annotations

import functools

import coal
import numpy as np
import pinocchio as pin
import pytest

from guidefield.collision.clearance import clearance_at, enclosed
from guidefield.collision.lanes.lanes import BatchCollision
from guidefield.collision.world import World
from guidefield.geometry import surfaces
from guidefield.kernels.collide.layout import BAND
from guidefield.kernels.cover.winding import winding_by_angles
from guidefield.messages import scene as messages
from guidefield.messages.values import Float32Array
from guidefield.robot.link_charges import surface_points
from guidefield.robot.model.collision_shapes import triangulation
from guidefield.scene.scene import build
from tests.collision.scenery import scattered
from tests.robots import group

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
    return np.array([world.group.chart(world.group.random(rng)) for _ in range(count)])


def narrowest(world: World, z: np.ndarray) -> float:
    """Smallest distance of all pairs."""
    clearance = clearance_at(world, world.group.expand_from_chart(z))
    return min(clearance.obstacle_distance, clearance.self_distance)


@pytest.mark.parametrize("robot", ["panda", "ur5"])
def test_touching_is_what_coal_says(robot: str) -> None:
    world, lanes = world_of(robot)
    zs = draw(world, 1000, 2)
    mine = lanes.touching(zs)
    by_coal = np.array([world.in_collision(world.group.expand_from_chart(z)) for z in zs])
    assert 0.2 < by_coal.mean() < 0.9
    for z in zs[mine & ~by_coal]:  # Coal sees a link's surface: a ball may be wholly inside
        assert narrowest(world, z) <= BAND or enclosed(world, world.group.expand_from_chart(z)) is not None
    assert not (by_coal & ~mine).any()


@pytest.mark.parametrize("robot", ["panda", "ur5"])
def test_close_to_contact_too(robot: str) -> None:
    """Where a motion into contact is halved down to a micrometre, both still agree but within the band."""
    world, lanes = world_of(robot)
    zs = draw(world, 300, 3)
    touching = np.array([world.in_collision(world.group.expand_from_chart(z)) for z in zs])
    for free, hit in zip(zs[~touching], zs[touching][:12], strict=False):
        low, high = free, hit
        for _ in range(22):
            middle = 0.5 * (low + high)
            low, high = (low, middle) if world.in_collision(world.group.expand_from_chart(middle)) else (middle, high)
        rows = np.concatenate([np.linspace(free, hit, 41), low + np.linspace(-1e-5, 1e-5, 9)[:, None]])
        mine = lanes.touching(rows)
        by_coal = np.array([world.in_collision(world.group.expand_from_chart(row)) for row in rows])
        assert not (by_coal & ~mine).any() or max(narrowest(world, row) for row in rows[by_coal & ~mine]) <= BAND
        for row in rows[mine & ~by_coal]:
            assert narrowest(world, row) <= BAND or enclosed(world, world.group.expand_from_chart(row)) is not None


def test_a_clearance_is_kept() -> None:
    world, lanes = world_of("panda")
    zs = draw(world, 300, 6)
    for z, touches in zip(zs, lanes.touching(zs, 0.05), strict=True):
        clearance = clearance_at(world, world.group.expand_from_chart(z))
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
            found = enclosed(world, q)
            assert world.in_collision(q) or (found is not None and found[1] == "dots")
            told += found is not None
    assert told > 0
