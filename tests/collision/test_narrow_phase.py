"""The narrow phase: flat bodies are not overlooked, and answers don't depend on the questions before."""

import dataclasses

import coal
import numpy as np
import pinocchio as pin
import pytest

from guidefield.collision.clearance import clearance_at
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
