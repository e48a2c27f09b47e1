"""Transforms as Coal takes them: they follow the robot's bodies, and what was moved goes back."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from hypothesis import given, settings, strategies as st

from tests.collision.scenery import panda_in
from tests.robots import random_configuration


def transforms_of(world):
    """Coal's transform of each body, as a matrix."""
    there = [world._transforms.of(body) for body in range(len(world.body_names))]
    return np.array([np.column_stack([one.getRotation(), one.getTranslation()]) for one in there])


def placements_of(world, q):
    """The same by Pinocchio's placements of joints, one by one."""
    data = world.model.createData()
    pin.forwardKinematics(world.model, data, world.group.expand(q))
    shapes = world.group.geometry.geometryObjects
    robot = [data.oMi[shape.parentJoint] * shape.placement for shape in shapes]
    return np.array([one.homogeneous[:3] for one in (*robot, *(o.placement for o in world.scene.obstacles))])


@settings(deadline=None, max_examples=6)
@given(st.lists(st.integers(0, 10**6), min_size=1, max_size=3))
def test_they_are_where_the_bodies_stand(seeds):
    world, kept = panda_in("bookshelf"), []
    for seed in seeds:
        q = random_configuration(world.group, seed)
        world.place(world.group.expand(q))
        kept.append((q, world.body_placements.copy()))
        np.testing.assert_allclose(transforms_of(world), placements_of(world, q), atol=1e-14)
    for q, placements in reversed(kept):
        world.put_bodies(placements)
        np.testing.assert_allclose(transforms_of(world), placements_of(world, q), atol=1e-14)
        np.testing.assert_array_equal(world.placement(3).homogeneous[:3], placements[3])


def test_what_was_moved_stands_where_it_did_once_the_robot_is_placed_anew():
    world = panda_in("bookshelf")
    q, body = world.group.expand(random_configuration(world.group, 1)), world.pairs.links + 1
    world.place(q)
    before = transforms_of(world)
    world.move(body, pin.SE3(np.eye(3), np.array([1.0, 2.0, 3.0])))
    assert transforms_of(world)[body, :, 3].tolist() == [1.0, 2.0, 3.0]
    world.place(q)
    np.testing.assert_array_equal(transforms_of(world), before)
