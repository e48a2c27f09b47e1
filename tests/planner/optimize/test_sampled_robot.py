"""The robot as points and capsules: where they are, and which of them count."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from guidefield.collision.world import World
from guidefield.messages import scene as messages
from guidefield.planner.optimize.sampled_robot import POINTS_WEIGHT, sampled_robot
from guidefield.scene.distance_tables import distance_tables
from tests.planner.problems import problem, scene_of

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
