"""The robot as points and capsules: where they are, and which of them count."""

from __future__ import annotations

import dataclasses

import numpy as np
import pinocchio as pin
import pytest

from guidefield.collision.world import World
from guidefield.kernels.simd.vector import LANES_64
from guidefield.messages import scene as messages
from guidefield.planner.optimize.sampled_robot import POINTS_WEIGHT, few_points, in_blocks, sampled_robot
from guidefield.robot.group.reduced_model import select
from guidefield.scene.distance_tables import distance_tables
from tests.planner.problems import problem, scene_of
from tests.robots import box_arm, grouped, robot

SHELF = messages.Box(name="shelf", size=(0.3, 0.3, 0.1), position=(0.5, 0.0, 0.3))


def test_points_lie_within_the_balls_and_weigh_alike() -> None:
    made = problem("panda", scene_of(SHELF), planes=())
    sampled = sampled_robot(made, distance_tables(made.scene), np.empty((0, 7)))
    assert sampled.weights.sum() == pytest.approx(POINTS_WEIGHT)
    assert np.ptp(sampled.weights) == 0.0
    arrays = [field for field in sampled if isinstance(field, np.ndarray)]
    assert len(arrays) > 8
    assert not any(array.flags.writeable for array in arrays)
    at = 0
    for (joint, first, last, coarse), ball in zip(sampled.groups, sampled.balls, strict=True):
        assert joint > 0
        assert first == at
        assert first < coarse <= last
        at = last
        points = sampled.points[:, first:last].T
        assert np.linalg.norm(points - ball[:3], axis=1).max() <= ball[3] + 1e-12
    assert at == sampled.points.shape[1]


def test_few_points_are_the_first_of_each_link_and_weigh_as_much_as_all() -> None:
    made = problem("panda", scene_of(SHELF), planes=())
    sampled = sampled_robot(made, distance_tables(made.scene), np.empty((0, 7)))
    few = few_points(sampled)
    for (joint, first, last, coarse), (same, begin, end, past) in zip(sampled.groups, few.groups, strict=True):
        assert (joint, first, coarse, coarse) == (same, begin, end, past)
        assert few.weights[begin:end].sum() == pytest.approx(sampled.weights[first:last].sum())


def test_blocks_are_of_neighbours_within_their_balls_and_the_few_points_stay_the_same() -> None:
    made = problem("panda", scene_of(SHELF), planes=())
    sampled = sampled_robot(made, distance_tables(made.scene), np.empty((0, 7)))
    radii, block = [], 0
    for begun, (_, first, last, _), whole in zip(sampled.first_blocks, sampled.groups, sampled.balls, strict=True):
        assert begun == block
        for at in range(first, last, LANES_64):
            *centre, radius = sampled.blocks[:, block]
            points = sampled.points[:, at : min(at + LANES_64, last)].T
            assert np.linalg.norm(points - centre, axis=1).max() <= radius + 1e-12
            radii.append(radius / whole[3])
            block += 1
    assert block == sampled.blocks.shape[1]
    assert np.median(radii) < 0.5
    points = np.random.default_rng(0).normal(size=(83, 3))
    ordered = in_blocks(points, 28)
    assert {*map(tuple, ordered[:28])} == {*map(tuple, points[:28])}
    assert {*map(tuple, ordered)} == {*map(tuple, points)}


def test_links_that_stand_still_have_no_points() -> None:
    model = robot("panda")
    wrist = select(model, ["panda_joint6", "panda_joint7"], None, model.rest, pin.SE3.Identity())
    made = problem(wrist, scene_of(SHELF), planes=())
    sampled = sampled_robot(made, distance_tables(made.scene), np.empty((0, 2)))
    moving = [shape for shape in wrist.geometry.geometryObjects if shape.parentJoint > 0]
    assert len(sampled.groups) == len(moving) < wrist.geometry.ngeoms
    # what stands still is still in the way of what moves
    assert 0 in {int(sampled.link_joints[k]) for _, k in sampled.pairs}


def test_what_may_touch_does_not_count() -> None:
    made = problem("panda", scene_of(SHELF), planes=())
    allowed = World.build(made.group, made.scene, [("panda_hand", "shelf"), ("panda_link2", "panda_link5")])
    before = sampled_robot(made, distance_tables(made.scene), np.empty((0, 7)))
    after = sampled_robot(dataclasses.replace(made, world=allowed), distance_tables(made.scene), np.empty((0, 7)))
    assert not before.ignored.any()
    links = [made.group.robot.link_of_geometry(i) for i in range(made.group.geometry.ngeoms)]
    moving = [n for n, s in zip(links, made.group.geometry.geometryObjects, strict=True) if s.parentJoint > 0]
    assert [moving[g] for g in np.flatnonzero(after.ignored[:, 0])] == ["panda_hand"]
    gone = {(moving[g], links[k]) for g, k in before.pairs} - {(moving[g], links[k]) for g, k in after.pairs}
    assert gone in ({("panda_link2", "panda_link5"), ("panda_link5", "panda_link2")}, set())
    assert len(gone) == 2 or ("panda_link2", "panda_link5") not in {(moving[g], links[k]) for g, k in before.pairs}


def test_followers_are_driven() -> None:
    planned = grouped(box_arm("y x mimic", 0))
    sampled = sampled_robot(
        problem(planned, scene_of(SHELF), planes=()), distance_tables(scene_of(SHELF)), np.empty((0, 2))
    )
    np.testing.assert_array_equal(sampled.joints.sources, [0, 1, 0])
    np.testing.assert_allclose(sampled.joints.multipliers, [1.0, 1.0, -0.5])
    np.testing.assert_allclose(sampled.joints.offsets, [0.0, 0.0, 0.2])
