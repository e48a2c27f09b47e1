"""The barrier of a robot and its derivatives, against Pinocchio's kinematics and plain formulas."""

import functools
import math
from collections.abc import Callable

import coal
import numpy as np
import pinocchio as pin
import pytest

from guidefield.kernels.distance.distance import distance_at_points
from guidefield.kernels.linalg.bordered_band import COUPLED
from guidefield.kernels.optimize.barrier import SOFT, STEEPNESS, SampledRobot
from guidefield.kernels.optimize.clearance_model import MotionSamples, clearance_along
from guidefield.kernels.optimize.obstacle_barrier import nothing_remembered, obstacle_distance
from guidefield.kernels.optimize.robot_barrier import pair_distances
from guidefield.planner.optimize.clearance_samples import LEAST_RANGE, POINTS_WEIGHT, RANGE, sampled_robot
from guidefield.planner.task.problem import Problem
from guidefield.robot.group.group import PlanningGroup
from guidefield.scene.distance_tables import distance_tables, moving_tables
from tests.collision.scenery import scattered
from tests.planner.problems import problem, scene_of
from tests.robots import box_arm, group, grouped

GROUPS: dict[str, Callable[[], PlanningGroup]] = {
    "panda": lambda: group("panda"),
    "every single-axis kind": lambda: grouped(box_arm("y slide oblique continuous mimic", 0)),
    "planar": lambda: grouped(box_arm("planar x y", 0)),
    "floating": lambda: grouped(box_arm("floating x y", 0)),
    "ball joints": lambda: group("chain_fixed_6x300_r25"),
}
REACH, CLEARANCE, FLOOR = 0.08, 0.01, 0.05


@functools.cache
def made(name: str, seed: int = 0) -> tuple[Problem, np.ndarray]:
    """A robot among scattered obstacles, and a configuration at which some points are within range."""
    planned = GROUPS[name]()
    rng = np.random.default_rng(seed)
    made_for = problem(planned, scene_of(*scattered(rng, 12, 1.0)), planes=())
    robot, _ = sampled(made_for)
    for _ in range(500):
        z = planned.to_local(planned.random(rng))
        near = np.array([d for d, _, reach, _ in distances(made_for, robot, z) if d < reach])
        if len(near) > 3 and near.min() > -0.05:
            return made_for, z
    raise AssertionError("no configuration near obstacles")


def sampled(made_for: Problem, ends: np.ndarray | None = None) -> tuple[SampledRobot, object]:
    tables = distance_tables(made_for.scene)
    return sampled_robot(made_for, tables, np.empty((0, made_for.group.nv)) if ends is None else ends), tables


def distances(made_for: Problem, robot: SampledRobot, z: np.ndarray) -> list[tuple[float, float, float, float]]:
    """Distance, weight, range and floor of every point against obstacles; against links by Coal, without floor."""
    model = made_for.group.model
    data = model.createData()
    pin.forwardKinematics(model, data, made_for.group.expand_from_local(z))
    world = [
        robot.points[:, first:last].T @ data.oMi[joint].rotation.T + data.oMi[joint].translation
        for joint, first, last, _ in robot.groups.tolist()
    ]
    weights = [robot.weights[first:last] for _, first, last, _ in robot.groups]
    found = []
    for points, of_points in zip(world, weights, strict=True):
        to_obstacles = distance_at_points(distance_tables(made_for.scene), points)[0] - CLEARANCE
        found += [(d, w, REACH, FLOOR - CLEARANCE) for d, w in zip(to_obstacles, of_points, strict=True)]
    shapes = list(made_for.group.geometry.geometryObjects)
    for (g, body), reach in zip(robot.pairs, robot.pair_ranges, strict=True):
        placed = data.oMi[shapes[body].parentJoint] * shapes[body].placement
        _, first, last, coarse = robot.groups[g]
        apart = [point_distance(shapes[body].geometry, placed, point) for point in world[g][: coarse - first]]
        w = POINTS_WEIGHT / robot.points.shape[1] * (last - first) / (coarse - first)
        found += [(d, w, float(reach), 0.0) for d in apart]
    return found


def point_distance(shape: object, placement: pin.SE3, point: np.ndarray) -> float:
    """Signed distance of a point from a convex shape, by Coal."""
    there = coal.Transform3s(placement.rotation, placement.translation)
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    return coal.distance(coal.Sphere(1e-12), coal.Transform3s(np.eye(3), point), shape, there, request, result)


def plain(distance: float, reach: float) -> float:
    """The barrier, written down once more."""

    def law(d: float) -> float:
        return (1.0 - d / reach) ** 2 / (d / reach) ** 3 if d < reach else 0.0

    soft = SOFT
    if distance >= soft:
        return law(distance)
    h = 1e-4 * reach
    slope, bend = (law(soft + h) - law(soft - h)) / (2 * h), (law(soft + h) - 2 * law(soft) + law(soft - h)) / h**2
    return law(soft) + slope * (distance - soft) + 0.5 * bend * (distance - soft) ** 2


def cost(distance: float, reach: float, floor: float) -> float:
    """The barrier and what is wanting of the floor, both measured from the clearance."""
    wanting = (floor - distance) / FLOOR if distance < floor else 0.0
    return plain(distance, reach) + STEEPNESS * wanting**2


class Barrier:
    """The barrier at one configuration, which is that of a motion with a single sample on its last control point."""

    def __init__(self, made_for: Problem, ends: np.ndarray | None = None):
        self.made_for, (self.robot, self.tables) = made_for, sampled(made_for, ends)
        walls = np.full(1, REACH), np.full(1, FLOOR)
        rows = np.zeros(1, np.int64), np.zeros(1), np.eye(4)[3:], np.ones(1), *walls, np.ones(1)
        for row in rows:
            row.setflags(write=False)
        self.samples, self.near = MotionSamples(*rows), nothing_remembered(1, len(self.robot.groups))

    def __call__(self, z: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """Value, gradient and Hessian."""
        nv = len(z)
        points, gradient = np.vstack([np.zeros((COUPLED, nv)), z]), np.empty((COUPLED + 1, nv))
        pieces, basis, hessians = np.empty(1, np.int64), np.empty((1, 4)), np.empty((1, nv, nv))
        value, count = clearance_along(
            self.robot, self.tables, moving_tables(self.made_for.scene), self.samples, points, 1.0, 0.0, CLEARANCE,
            math.inf, self.near, gradient, pieces, basis, hessians, np.empty((2, COUPLED + 1, nv)), np.empty(2),
            np.empty((2, 2)),
        )  # fmt: skip
        assert count == (value > 0.0)
        return value, gradient[COUPLED], hessians[0] if count else np.zeros((nv, nv))


@pytest.mark.parametrize("name", GROUPS)
def test_the_barrier_of_a_robot_is_the_sum_over_its_points(name: str) -> None:
    made_for, z = made(name)
    value, *_ = (one := Barrier(made_for))(z)
    expected = sum(w * cost(d, reach, floor) for d, w, reach, floor in distances(made_for, one.robot, z))
    assert value == pytest.approx(expected, rel=1e-5)
    assert value > 0.0


@pytest.mark.parametrize("name", GROUPS)
@pytest.mark.parametrize("seed", [0])
def test_its_gradient_is_its_derivative(name: str, seed: int) -> None:
    made_for, z = made(name, seed)
    one, step = Barrier(made_for), 1e-6
    numeric = np.array([(one(z + e)[0] - one(z - e)[0]) / (2 * step) for e in step * np.eye(len(z))])
    np.testing.assert_allclose(one(z)[1], numeric, rtol=1e-4, atol=1e-4 * np.abs(numeric).max())


@pytest.mark.parametrize("name", GROUPS)
def test_its_hessian_is_gauss_and_newtons(name: str) -> None:
    made_for, z = made(name)
    one, step = Barrier(made_for), 1e-6
    *_, hessian = one(z)
    here = distances(made_for, one.robot, z)

    def only(z: np.ndarray) -> np.ndarray:
        return np.array([d for d, _, _, _ in distances(made_for, one.robot, z)])

    rows = np.array([only(z + e) - only(z - e) for e in step * np.eye(len(z))]).T / (2 * step)
    h = 1e-6
    bends = [w * (cost(d + h, r, f) - 2 * cost(d, r, f) + cost(d - h, r, f)) / h**2 for d, w, r, f in here]
    expected = np.einsum("i,ij,ik->jk", bends, rows, rows)
    np.testing.assert_allclose(hessian, expected, rtol=2e-2, atol=1e-2 * np.abs(expected).max())
    np.testing.assert_allclose(hessian, hessian.T, rtol=1e-12)
    assert np.linalg.eigvalsh(hessian).min() >= -1e-9 * np.abs(hessian).max()


def test_links_within_range_at_an_end_are_let_in_that_far() -> None:
    made_for = problem("panda", scene_of(), planes=())
    robot, tables = sampled(made_for)
    rng = np.random.default_rng(0)
    closest = np.empty(len(robot.pairs))
    for _ in range(20_000):
        z = made_for.group.to_local(made_for.group.random(rng))
        pair_distances(robot, tables, z, closest)
        if LEAST_RANGE < closest.min() < 0.5 * RANGE:
            break
    assert LEAST_RANGE < closest.min() < 0.5 * RANGE
    strict, lenient = Barrier(made_for)(z)[0], Barrier(made_for, ends=z[None])(z)[0]
    assert strict > 0.0
    assert lenient == pytest.approx(0.0, abs=1e-12)


def test_the_distances_of_pairs_are_those_of_their_points_within_range() -> None:
    made_for, _ = made("panda")
    robot, tables = sampled(made_for)
    closest, rng = np.empty(len(robot.pairs)), np.random.default_rng(0)
    for _ in range(20_000):
        z = made_for.group.to_local(made_for.group.random(rng))
        pair_distances(robot, tables, z, closest)
        if 0.0 < closest.min() < np.inf:  # links within range, none inside another
            break
    assert 0.0 < closest.min() < np.inf
    own = [d for d, *_ in distances(made_for, robot, z)][robot.points.shape[1] :]
    at = 0
    for (g, _), distance in zip(robot.pairs, closest, strict=True):
        count = robot.groups[g, 3] - robot.groups[g, 1]
        smallest = min(own[at : at + count])
        assert distance == (pytest.approx(smallest, abs=1e-6) if smallest < RANGE - 1e-6 else np.inf)
        at += count


@pytest.mark.parametrize("name", GROUPS)
def test_the_distance_from_obstacles_is_that_of_the_nearest_point(name: str) -> None:
    made_for, z = made(name)
    robot, tables = sampled(made_for)
    nearest = min(d for d, *_ in distances(made_for, robot, z)[: robot.points.shape[1]]) + CLEARANCE
    assert obstacle_distance(robot, tables, z, np.inf) == pytest.approx(nearest, abs=1e-9)
    assert obstacle_distance(robot, tables, z, 1.0) == pytest.approx(nearest, abs=1e-9)
    assert obstacle_distance(robot, tables, z, nearest - 0.01) == nearest - 0.01
