"""The packaged scenes: readable, sound, and with guide planes in free space."""

import coal
import numpy as np
import pinocchio as pin
import pytest

from guidefield.collision.clearance import clearance_at, find_enclosed_pair
from guidefield.collision.world import World
from guidefield.scene import obstacle_parts
from guidefield.scene.scene import build
from guidefield.stores import scenes
from tests.robots import group, rest

OURS = ("bookshelf", "kitchen", "table", "wall_with_window")
ON_THE_GOAL = {
    "bookshelf": [-1.81, 0.742, 2.064, -2.363, -2.638, 2.455, 2.897],
    "kitchen": [1.352, -1.48, -0.924, -2.293, -2.132, 2.398, -1.394],
    "table": [-1.501, -1.537, 1.408, -2.296, 2.882, 2.47, 0.08],
    "wall_with_window": [-1.255, -0.521, 1.181, -2.196, 2.897, 2.66, -1.497],
}
"""Panda configurations with the tip on the last guide plane, the hand horizontal (found once by inverse kinematics)."""


def transform(obstacle):
    return coal.Transform3s(obstacle.placement.rotation, obstacle.placement.translation)


def test_names_are_those_that_can_be_read():
    assert set(OURS) < set(scenes.list_packaged())
    for name in scenes.list_packaged():
        assert scenes.read_packaged(name).name == name


TRIANGLES = {
    "seed_a_gates": 204,
    "seed_b_tapered": 32,
    "seed_c_blocked": 216,
    "seed_d_passage_3": 40,
    "seed_e_S_6": 144,
}


@pytest.mark.parametrize(("name", "count"), TRIANGLES.items())
def test_seed_scenes_have_the_triangles_that_their_description_tells(name, count):
    scene = build(scenes.read_packaged(name))
    assert sum(len(obstacle.triangles) for obstacle in scene.obstacles) == count


@pytest.mark.parametrize("name", scenes.list_packaged())
def test_guide_planes_are_in_free_space(name):
    scene = build(scenes.read_packaged(name))
    assert scene.warnings == ()
    assert scene.guide_planes
    for plane in scene.guide_planes:
        # Their edges may touch obstacles; a millimetre inside, nothing does.
        corners = plane.inset_vertices(1e-3)
        fan = np.array([[0, i, i + 1] for i in range(1, len(corners) - 1)])
        sheet = obstacle_parts.bvh(corners, fan)
        for obstacle in scene.obstacles:
            request, result = coal.CollisionRequest(), coal.CollisionResult()
            here = coal.Transform3s.Identity()
            assert not coal.collide(sheet, here, obstacle.shape, transform(obstacle), request, result), (
                plane,
                obstacle,
            )


@pytest.mark.parametrize("name", OURS)
def test_obstacles_do_not_overlap(name):
    scene = build(scenes.read_packaged(name))
    for i, a in enumerate(scene.obstacles):
        for b in scene.obstacles[:i]:
            request, result = coal.DistanceRequest(), coal.DistanceResult()
            gap = coal.distance(a.shape, transform(a), b.shape, transform(b), request, result)
            assert gap > -1e-6, (a.name, b.name, gap)  # things stand on boards, boards meet sides


@pytest.mark.parametrize("name", OURS)
def test_the_ready_panda_keeps_ten_centimetres(name):
    panda = group("panda")
    world = World.build(panda, build(scenes.read_packaged(name)))
    assert clearance_at(world, rest(panda)).obstacle_distance > 0.1
    assert find_enclosed_pair(world, rest(panda)) is None


@pytest.mark.parametrize("name", OURS)
def test_a_panda_reaches_the_last_plane_with_its_hand_horizontal(name):
    panda = group("panda")
    scene = build(scenes.read_packaged(name))
    q = np.array(ON_THE_GOAL[name])
    data = panda.model.createData()
    pin.framesForwardKinematics(panda.model, data, q)
    tip = data.oMf[panda.tip_id]
    plane = scene.guide_planes[-1]
    assert abs(plane.signed_height(tip.translation)) < 2e-3  # the angles are rounded
    assert plane.contains(tip.translation, inset=0.05)
    assert tip.rotation[:, 2] == pytest.approx([1, 0, 0], abs=5e-3)
    assert clearance_at(World.build(panda, scene), q).obstacle_distance > 0.05
