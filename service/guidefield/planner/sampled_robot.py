"""The robot of a problem as the relaxation's kernels read it: points against obstacles, points against capsules."""

from __future__ import annotations

import numpy as np

from guidefield.kernels.distance import DistanceTables
from guidefield.kernels.sampled_robot import SampledRobot
from guidefield.kernels.self_barrier import SELF_RANGE, pair_distances
from guidefield.planner.problem import Problem
from guidefield.robot.charges import robot_charges
from guidefield.robot.surface_samples import surface_samples

WEIGHT = 100.0
"""Sum of the weights of all points."""


def sampled_robot(problem: Problem, tables: DistanceTables, ends: np.ndarray) -> SampledRobot:
    """The moving links of a problem's robot as points, and the pairs of links that are kept apart.

    Bodies that stand still don't count, nor do pairs that the world doesn't test. A capsule is wider than the link in
    it: links that are within range of each other at an end of a path are let in that far all along it.

    Args:
        problem: Robot, world and field.
        tables: Obstacles.
        ends: Chart points at which links may be as close as they are, shape (m, nv).
    """
    group, charged = problem.group, problem.robot_field.charged
    moving = [body for body, shape in enumerate(group.geometry.geometryObjects) if shape.parentJoint > 0]
    points = _points(problem, moving)
    counts = np.array([len(some) for some in points], np.int64)
    last = np.cumsum(counts)
    joints = [group.geometry.geometryObjects[body].parentJoint for body in moving]
    pairs = _pairs(problem, moving)
    robot = SampledRobot(
        joints=problem.robot_field.joints,
        drivers=np.abs(group.expand_velocity).argmax(axis=1),
        multipliers=group.expand_velocity.sum(axis=1),
        offsets=group.expand_offset,
        origin=group.expand(group.q_origin),
        points=np.ascontiguousarray(np.concatenate([np.empty((0, 3)), *points]).T),
        weights=np.full(int(counts.sum()), WEIGHT / max(int(counts.sum()), 1)),
        groups=np.column_stack([np.array(joints, np.int64), last - counts, last]),
        balls=np.array([_ball(some) for some in points]).reshape(-1, 4),
        ignored=_ignored(problem, moving),
        capsules=charged.capsules,
        capsule_joints=charged.capsule_joints,
        pairs=pairs,
        slacks=np.zeros(len(pairs)),
    )
    _freeze(robot)
    closest = np.full(len(pairs), np.inf)
    for z in ends:
        distances = np.empty(len(pairs))
        pair_distances(robot, tables, np.ascontiguousarray(z), distances)
        closest = np.minimum(closest, distances)
    robot = robot._replace(slacks=np.maximum(0.0, SELF_RANGE - closest))
    _freeze(robot)
    return robot


def _indices(problem: Problem) -> list[int]:
    """Index in the whole robot's geometry of every body of the group's."""
    indices = {shape.name: index for index, shape in enumerate(problem.group.robot.geometry.geometryObjects)}
    return [indices[shape.name] for shape in problem.group.geometry.geometryObjects]


def _points(problem: Problem, moving: list[int]) -> list[np.ndarray]:
    """Points of every moving body, each (n, 3) in the frame of its joint [m]."""
    samples, indices = surface_samples(problem.group.robot), _indices(problem)
    placements = [problem.group.geometry.geometryObjects[body].placement for body in moving]
    return [
        samples[indices[body]] @ placement.rotation.T + placement.translation
        for body, placement in zip(moving, placements, strict=True)
    ]


def _ball(points: np.ndarray) -> np.ndarray:
    """Centre and radius of a ball about points."""
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    ball: np.ndarray = np.r_[centre, np.linalg.norm(points - centre, axis=1).max()]
    return ball


def _ignored(problem: Problem, moving: list[int]) -> np.ndarray:
    """Which obstacles don't count for which moving bodies: those that the world doesn't test against them."""
    bodies, obstacles = problem.group.geometry.ngeoms, len(problem.scene.obstacles)
    ignored = np.ones((bodies, obstacles), bool)
    tested = problem.world.pairs[problem.world.is_obstacle_pair]
    ignored[tested[:, 0], tested[:, 1] - bodies] = False
    return np.ascontiguousarray(ignored[moving])


def _pairs(problem: Problem, moving: list[int]) -> np.ndarray:
    """Moving body (its place in `moving`) and capsule (k, 2) of the pairs that repel each other and are tested."""
    indices = _indices(problem)
    repelling = {frozenset(pair) for pair in robot_charges(problem.group.robot).repelling}
    place = {body: index for index, body in enumerate(moving)}
    pairs = [
        (place[points], capsule)
        for first, second in problem.world.pairs[: problem.world.n_self].tolist()
        if frozenset((indices[first], indices[second])) in repelling
        for points, capsule in ((first, second), (second, first))
        if points in place
    ]
    return np.array(pairs, np.int64).reshape(-1, 2)


def _freeze(robot: SampledRobot) -> None:
    for array in robot[1:]:
        array.setflags(write=False)
