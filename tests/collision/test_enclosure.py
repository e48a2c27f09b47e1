"""Bodies wholly inside closed meshes, which Coal alone doesn't notice."""

import dataclasses

import numpy as np
import pytest

from guidefield.collision.clearance import enclosed
from guidefield.geometry import cache
from guidefield.geometry.convex import bvh
from guidefield.kernels.jit.cache import cache_folder
from guidefield.messages import scene as messages
from guidefield.robot.group.group import Alike
from tests.collision.scenery import box, world_of
from tests.robots import box_arm, group, grouped, rest
from tests.scene.solids import box_mesh, l_prism, mesh_message, room


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
    assert enclosed(world, rest(arm)) is not None
    assert enclosed(world, rest(arm))[1] == "m"


def test_a_robot_in_the_notch_is_not_enclosed():
    arm = group("panda")
    vertices, triangles = l_prism()
    beside = mesh_message(4.0 * vertices, triangles, position=(-6.0, -6.0, -1.0))
    world = world_of(arm, [beside])
    assert not world.in_collision(rest(arm))
    assert enclosed(world, rest(arm)) is None


def test_a_robot_in_a_hollow_is_free_and_one_in_its_wall_is_not():
    arm = group("panda")
    assert enclosed(world_of(arm, [mesh_message(*room(5.0, 3.0))]), rest(arm)) is None
    walled = mesh_message(*room(9.0, 1.0), position=(0.0, 0.0, 2.8))
    assert not world_of(arm, [walled]).in_collision(rest(arm))
    assert enclosed(world_of(arm, [walled]), rest(arm)) is not None


def test_a_robot_in_a_box_of_single_triangles_is_enclosed():
    arm = group("panda")
    vertices, triangles = box_mesh(6.0)
    corners = vertices[triangles].reshape(-1, 3)
    corners += np.random.default_rng(0).uniform(-5e-6, 5e-6, corners.shape)
    world = world_of(arm, [mesh_message(corners, np.arange(len(corners)).reshape(-1, 3))])
    assert enclosed(world, rest(arm)) is not None
    assert "cracks" in world.scene.warnings[0]


def test_an_open_mesh_encloses_nothing():
    arm = group("panda")
    vertices, triangles = box_mesh(6.0)
    world = world_of(arm, [mesh_message(vertices, triangles[1:])])
    assert enclosed(world, rest(arm)) is None


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
        assert (enclosed(world, q) is not None) is expected
