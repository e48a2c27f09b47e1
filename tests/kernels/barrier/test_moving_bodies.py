"""Bodies on screws and the barrier against them: by Pinocchio's placements, Coal, and finite differences in time."""

import coal
import numpy as np
import pinocchio as pin
import pytest

from guidefield.kernels.barrier.moving_bodies import moved_bodies, place_moved
from guidefield.kernels.barrier.obstacle_barrier import moving_distance
from guidefield.kernels.distance.distance import distance_at_points
from guidefield.scene.distance_tables import distance_tables, moving_tables
from tests.kernels.barrier.test_robot_barrier import sampled
from tests.planner.problems import problem, scene_of
from tests.planner.test_moving_kinds import KINDS, moving
from tests.robots import group

PANDA = group("panda")
FARTHEST = 0.25  # ends count as keeping at most so much [m]
TIMES = (-0.5, 0.2, 0.9, 1.6, 2.3, 9.0)


@pytest.mark.parametrize("kind", ["box", "half space", "cloud", "dented mesh"])
def test_frames_are_where_pinocchio_has_them_and_as_fast_as_they_move(kind: str) -> None:
    scene = scene_of(*(moving(kind, f"o{k}", np.random.default_rng([k, 3])) for k in range(3)))
    tables = moving_tables(scene)
    moved, ahead, behind = (moved_bodies(tables, 1, 1) for _ in range(3))
    h, point = 1e-6, np.array([0.4, -0.3, 0.7])
    for time in TIMES:
        for each, at in ((moved, time), (ahead, time + h), (behind, time - h)):
            place_moved(tables, at, each)
        for k, one in enumerate(scene.obstacles):
            np.testing.assert_allclose(moved.frames[k], one.motion.at(time).homogeneous[:3], atol=1e-12)
            body = one.motion.at(time).actInv(point)
            way = pin.SE3(_whole(ahead.frames[k])).act(body) - pin.SE3(_whole(behind.frames[k])).act(body)
            expected = moved.velocities[k, :3] + np.cross(moved.velocities[k, 3:], point)
            np.testing.assert_allclose(way / (2.0 * h), expected, atol=1e-6 * (1.0 + np.abs(expected).max()))


def _whole(placement: np.ndarray) -> np.ndarray:
    return np.vstack([placement, [0.0, 0.0, 0.0, 1.0]])


@pytest.mark.parametrize("kind", KINDS)
def test_the_distance_is_that_to_the_obstacles_as_they_stand_then(kind: str) -> None:
    """By tables of the scene at that time, in which clouds and surfaces are built anew; of convex ones by Coal too."""
    rng = np.random.default_rng([KINDS.index(kind), 5])
    scene = scene_of(*(moving(kind, f"o{k}", rng) for k in range(2)))
    made, z = problem(PANDA, scene, planes=()), PANDA.chart(PANDA.random(rng))
    robot, _ = sampled(made)
    data = PANDA.model.createData()
    pin.forwardKinematics(PANDA.model, data, PANDA.expand_from_chart(z))
    joints = robot.groups[:, 0].tolist()
    points = np.concatenate(
        [
            robot.points[:, first:last].T @ data.oMi[joint].rotation.T + data.oMi[joint].translation
            for joint, (first, last) in zip(joints, robot.groups[:, 1:3].tolist(), strict=True)
        ]
    )
    for time in TIMES:
        found = moving_distance(robot, moving_tables(scene), z, time, 5.0)
        then = distance_at_points(distance_tables(scene.at(time)), points)[0].min()
        assert found == pytest.approx(min(then, 5.0), abs=2e-6)
        if kind in ("box", "sphere", "capsule", "cylinder", "half space"):
            apart = min(_by_coal(one, time, point) for one in scene.obstacles for point in points)
            assert found == pytest.approx(min(apart, 5.0), abs=1e-6)
    assert moving_distance(robot, moving_tables(scene), z, 0.0, 1e-3) <= FARTHEST


def _by_coal(one: object, time: float, point: np.ndarray) -> float:
    at = one.placement_at(time)
    there = coal.Transform3s(at.rotation, at.translation)
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    return coal.distance(coal.Sphere(1e-12), coal.Transform3s(np.eye(3), point), one.shape, there, request, result)
