"""Clearance against Coal's distance of every pair; bodies wholly inside closed meshes."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.collision.clearance import clearance_at, find_enclosed_pair
from guidefield.geometry import cache
from guidefield.geometry.convex import bvh
from guidefield.kernels.jit.cache import cache_folder
from guidefield.messages import scene as messages
from guidefield.robot.group.group import Alike
from tests.collision.plain import are_signed, panda_among
from tests.collision.scenery import box, panda_in, world_of
from tests.collision.test_world import SCENES, pair_distances
from tests.robots import box_arm, group, grouped, random_configuration, rest
from tests.scene.solids import box_mesh, l_prism, mesh_message, room

ACCURACY = 2e-6  # Coal's, for distances of convex bodies

HULL = 5e-4  # how far the Panda's hulls stand off its meshes at most, with what sampling misses


@settings(max_examples=18)
@given(st.sampled_from(SCENES), st.integers(0, 10**6))
def test_smallest_distances_are_those_of_all_pairs(name, seed):
    world = panda_in(name)
    q = random_configuration(world.group, seed)
    distances = pair_distances(world, q)
    distances[~are_signed(world)] = np.maximum(distances[~are_signed(world)], 0.0)
    at = clearance_at(world, q)
    assert at.self_distance == pytest.approx(distances[: world.pairs.n_self].min(), abs=ACCURACY)
    assert at.obstacle_distance == pytest.approx(distances[world.pairs.n_self :].min(), abs=ACCURACY)
    named = [k for k in range(world.pairs.n_self, len(world.pairs)) if world.pair_names(k) == at.obstacle_pair]
    assert distances[named].min() == pytest.approx(at.obstacle_distance, abs=ACCURACY)
    own = [k for k in range(world.pairs.n_self) if world.pair_names(k) == at.self_pair]
    assert distances[own].min() == pytest.approx(at.self_distance, abs=ACCURACY)


@pytest.mark.parametrize("seed", range(4))
def test_hulls_hide_no_mesh_that_is_closer(seed):
    world = world_of(group("ur5"), [box("shelf", (0.5, 0.5, 0.02), (0.4, 0.1, 0.5))])
    assert not are_signed(world).all()
    q = random_configuration(world.group, seed)
    distances = np.maximum(pair_distances(world, q), np.where(are_signed(world), -np.inf, 0.0))
    at = clearance_at(world, q)
    assert at.self_distance == pytest.approx(distances[: world.pairs.n_self].min(), abs=ACCURACY)
    assert at.obstacle_distance == pytest.approx(distances[world.pairs.n_self :].min(), abs=ACCURACY)


@settings(max_examples=12)
@given(st.integers(0, 10**6))
def test_witness_points_are_as_far_apart_as_the_distance(seed):
    world = panda_in("bookshelf")
    at = clearance_at(world, random_configuration(world.group, seed))
    if at.obstacle_distance > 1e-4:
        assert np.linalg.norm(at.witness[0] - at.witness[1]) == pytest.approx(at.obstacle_distance, abs=1e-5)
        obstacle = world.scene.obstacle(at.obstacle_pair[1])
        local = np.abs(obstacle.placement.actInv(at.witness[1]))
        assert (local <= 0.5 * (obstacle.shape.aabb_local.max_ - obstacle.shape.aabb_local.min_) + 1e-5).all()


def test_hulls_are_as_far_away_as_the_meshes():
    world = panda_in("bookshelf")
    plain = panda_among(world.scene.message.obstacles, finger=0.001)
    rng = np.random.default_rng(3)
    for q in [rest(world.group), *(rest(world.group) + rng.uniform(-0.4, 0.4, (12, 7)))]:
        distances = plain.distances(q)[plain.self_pairs :]
        if distances.min() > 0:
            assert 0 <= distances.min() - clearance_at(world, q).obstacle_distance + ACCURACY <= HULL


@pytest.fixture(autouse=True, params=[cache.LARGE, 1], ids=["small", "large"])
def _size(request, monkeypatch, tmp_path):
    """Each mesh as a small one, and as a large one."""
    monkeypatch.setattr(cache, "LARGE", request.param)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(cache_folder().parents[1]))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))


def test_a_robot_inside_a_solid_mesh_touches_nothing_but_is_enclosed():
    arm = group("panda")
    vertices, triangles = l_prism()
    around = mesh_message(4.0 * vertices, triangles, position=(-1.5, -1.5, -1.0))
    world = world_of(arm, [box("far", (0.1, 0.1, 0.1), (3, 0, 0)), around])
    assert not world.in_collision(rest(arm))
    assert find_enclosed_pair(world, rest(arm)) is not None
    assert find_enclosed_pair(world, rest(arm))[1] == "m"


def test_a_robot_in_the_notch_is_not_enclosed():
    arm = group("panda")
    vertices, triangles = l_prism()
    beside = mesh_message(4.0 * vertices, triangles, position=(-6.0, -6.0, -1.0))
    world = world_of(arm, [beside])
    assert not world.in_collision(rest(arm))
    assert find_enclosed_pair(world, rest(arm)) is None


def test_a_robot_in_a_hollow_is_free_and_one_in_its_wall_is_not():
    arm = group("panda")
    assert find_enclosed_pair(world_of(arm, [mesh_message(*room(5.0, 3.0))]), rest(arm)) is None
    walled = mesh_message(*room(9.0, 1.0), position=(0.0, 0.0, 2.8))
    assert not world_of(arm, [walled]).in_collision(rest(arm))
    assert find_enclosed_pair(world_of(arm, [walled]), rest(arm)) is not None


def test_a_robot_in_a_box_of_single_triangles_is_enclosed():
    arm = group("panda")
    vertices, triangles = box_mesh(6.0)
    corners = vertices[triangles].reshape(-1, 3)
    corners += np.random.default_rng(0).uniform(-5e-6, 5e-6, corners.shape)
    world = world_of(arm, [mesh_message(corners, np.arange(len(corners)).reshape(-1, 3))])
    assert find_enclosed_pair(world, rest(arm)) is not None
    assert "cracks" in world.scene.warnings[0]


def test_an_open_mesh_encloses_nothing():
    arm = group("panda")
    vertices, triangles = box_mesh(6.0)
    world = world_of(arm, [mesh_message(vertices, triangles[1:])])
    assert find_enclosed_pair(world, rest(arm)) is None


def test_an_obstacle_inside_a_robots_mesh_is_noticed():
    arm = grouped(box_arm("y", 1))
    vertices, triangles = l_prism()
    hollow = arm.geometry.copy()
    moving = next(i for i, shape in enumerate(hollow.geometryObjects) if shape.parentJoint == 1)
    hollow.geometryObjects[moving].geometry = bvh(vertices, triangles)
    other = dataclasses.replace(arm.robot, geometry=hollow)
    hollowed = dataclasses.replace(arm, geometry=hollow, robot=other, alike=Alike())
    q = np.zeros(1)
    for position, expected in (((0.5, 0.5, 0.95), True), ((1.5, 1.5, 0.95), False)):
        pebble = messages.Sphere(name="pebble", radius=0.05, position=position)
        world = world_of(hollowed, [pebble])
        assert not world.in_collision(q)
        assert (find_enclosed_pair(world, q) is not None) is expected
