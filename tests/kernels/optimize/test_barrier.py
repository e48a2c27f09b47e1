"""The barrier as a function of distance, and bodies on screws: by Pinocchio's placements, Coal, finite differences."""

import coal
import numpy as np
import pinocchio as pin
import pytest

from guidefield.kernels.distance.distance import distance_at_points
from guidefield.kernels.optimize.barrier import SOFT, barrier, moved_bodies, place_moved
from guidefield.kernels.optimize.obstacle_barrier import moving_distance
from guidefield.scene.distance_tables import distance_tables, moving_tables
from tests.kernels.optimize.test_robot_barrier import sampled
from tests.kernels.parts import from_python
from tests.planner.problems import problem, scene_of
from tests.planner.test_moving_kinds import KINDS, moving
from tests.robots import group

of_a_size = from_python(barrier)

RANGES = (0.08, 0.04, 0.012)


def penalty(distance: float, reach: float) -> tuple[float, float, float]:
    """The barrier of a robot of usual size."""
    return of_a_size(distance, reach, 1.0)


@pytest.mark.parametrize("reach", RANGES)
def test_it_is_the_formula_between_soft_and_range(reach: float) -> None:
    for distance in np.linspace(max(SOFT, 0.5 * reach), reach, 20):
        x = distance / reach
        assert penalty(distance, reach)[0] == pytest.approx((1.0 - x) ** 2 / x**3, abs=1e-12)


@pytest.mark.parametrize("reach", RANGES)
def test_its_derivatives_are_its_own(reach: float) -> None:
    step = 1e-6 * reach
    for distance in (-0.3, -0.01, 0.0, 0.004, 0.3 * reach, 0.7 * reach, 0.95 * reach, 1.5 * reach):
        before, here, after = (penalty(distance + k * step, reach) for k in (-1, 0, 1))
        assert here[1] == pytest.approx((after[0] - before[0]) / (2 * step), rel=1e-5, abs=1e-5)
        if abs(distance - SOFT) > step:
            assert here[2] == pytest.approx((after[1] - before[1]) / (2 * step), rel=1e-5, abs=1e-3)


@pytest.mark.parametrize("reach", RANGES)
def test_it_falls_is_convex_and_continuous(reach: float) -> None:
    distances = np.linspace(-0.5, 1.2 * reach, 20001)
    values, slopes, curvatures = np.array([penalty(d, reach) for d in distances]).T
    assert (np.diff(values) <= 0.0).all()
    assert (np.diff(slopes) >= -1e-9 * np.abs(slopes).max()).all()
    assert (curvatures >= 0.0).all()
    for edge in (min(SOFT, 0.5 * reach), reach):
        a, b = penalty(edge - 1e-12, reach), penalty(edge + 1e-12, reach)
        np.testing.assert_allclose(a[:2], b[:2], rtol=1e-6, atol=1e-6)
    assert penalty(reach, reach) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("distance", [-0.01, 0.004, 0.03])
def test_it_goes_with_the_size(distance: float) -> None:
    value, slope, curvature = penalty(distance, 0.08)
    assert of_a_size(8.0 * distance, 8.0 * 0.08, 8.0) == pytest.approx((value, slope / 8.0, curvature / 64.0))


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
