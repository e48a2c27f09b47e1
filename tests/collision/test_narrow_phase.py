"""The narrow phase: flat bodies are not overlooked, and answers don't depend on the questions before."""

import dataclasses

import coal
import numpy as np
import pinocchio as pin
import pytest
import trimesh

from guidefield.collision.clearance import clearance_at
from guidefield.collision.narrow_phase import NarrowPhase, transform
from guidefield.geometry.convex import bvh
from guidefield.messages import scene as messages
from guidefield.robot.group.group import Alike
from tests.collision.scenery import box, panda_in, world_of
from tests.robots import box_arm, group, grouped, random_configuration, rest

PLATE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float), np.array([[0, 1, 2], [0, 2, 3]])


@pytest.mark.parametrize("axis", range(3))
def test_a_polygon_across_an_axis_is_touched(axis):
    arm = group("panda")
    square = np.array([[0.0, -0.2, -0.2], [0.0, 0.2, -0.2], [0.0, 0.2, 0.2], [0.0, -0.2, 0.2]])
    corners = np.roll(square, axis, axis=1) + np.array([0.307, 0.0, 0.6])
    for order in (corners, corners[::-1]):
        wall = messages.Polygon(name="wall", vertices=[tuple(row) for row in order.tolist()])
        assert world_of(arm, [wall]).in_collision(rest(arm))


@pytest.mark.parametrize("shape", [bvh(*PLATE), coal.Box(0.1, 0.2, 0.0)])
def test_a_flat_shape_of_a_link_is_touched(shape):
    arm = grouped(box_arm("y", 1))
    geometry = arm.geometry.copy()
    for body in geometry.geometryObjects:
        if body.parentJoint == 1:
            body.geometry = shape
            body.placement = pin.SE3.Identity()
    world = world_of(
        dataclasses.replace(arm, geometry=geometry, alike=Alike()),
        [box("crate", (0.05, 0.05, 0.05), (0.02, 0.02, 0.3))],
    )
    assert world.in_collision(np.zeros(1))


def test_a_distance_has_the_same_bits_whatever_was_asked_before():
    world = panda_in("bookshelf")
    qs = [random_configuration(world.group, seed) for seed in range(20)]
    forwards = [clearance_at(world, q) for q in qs]
    backwards = [clearance_at(world, q) for q in qs[::-1]][::-1]
    for a, b in zip(forwards, backwards, strict=True):
        assert a.obstacle_distance == b.obstacle_distance
        assert a.self_distance == b.self_distance
        assert np.array_equal(a.witness, b.witness)


@pytest.mark.parametrize("first", ["mesh", "box"])
@pytest.mark.parametrize("second", ["mesh", "cylinder", "capsule"])
def test_a_distance_up_to_a_bound_is_the_same_and_beyond_it_is_beyond(first, second):
    mesh = trimesh.creation.torus(0.3, 0.1)
    made = {
        "mesh": bvh(mesh.vertices, mesh.faces),
        "box": coal.Box(0.3, 0.2, 0.1),
        "cylinder": coal.Cylinder(0.1, 0.3),
        "capsule": coal.Capsule(0.1, 0.3),
    }
    rng = np.random.default_rng(3)
    for _ in range(20):
        turns = [pin.Quaternion(rng.normal(size=4)).normalized().matrix() for _ in range(2)]
        there = np.array([0.0, 3.0, 0.0]) + rng.normal(size=3)
        stand = [pin.SE3(turn, at) for turn, at in zip(turns, (np.zeros(3), there), strict=True)]
        narrow = NarrowPhase(lambda body: made[(first, second)[body]], lambda body, at=stand: transform(at[body]))
        apart = narrow.distance(0, 1).distance
        assert apart > 0.0
        assert narrow.distance(0, 1, 1.001 * apart).distance == pytest.approx(apart, rel=0.0, abs=1e-9)
        for bound in (0.1 * apart, 0.999 * apart):
            assert narrow.distance(0, 1, bound).distance >= bound
