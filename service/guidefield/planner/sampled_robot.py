"""The robot of a problem as the relaxation's kernels read it: points against obstacles, points against capsules."""

from __future__ import annotations

import numpy as np

from guidefield.kernels.barrier import SELF_RANGE, SampledRobot, pair_distances
from guidefield.kernels.distance import DistanceTables
from guidefield.planner.problem import Problem
from guidefield.robot.charges import robot_charges

WEIGHT = 100.0
"""Sum of the weights of all points."""


def sampled_robot(problem: Problem, tables: DistanceTables, ends: np.ndarray) -> SampledRobot:
    """The moving links of a problem's robot as points, and the pairs of links that are kept apart.

    Bodies that stand still don't count, nor do pairs that the world doesn't test. A capsule is wider than the link in it:
    links that are within range of each other at an end of a path are let in that far all along it.

    Args:
        problem: Robot, world and field.
        tables: Obstacles.
        ends: Chart points at which links may be as close as they are, shape (m, nv).
    """
    charged, group = problem.robot_field.charged, problem.group
    ranges = _point_ranges(problem)
    moving = [body for body, (first, _) in enumerate(ranges) if charged.point_joints[first] > 0]
    groups = np.array([(charged.point_joints[ranges[b][0]], *ranges[b]) for b in moving], np.int64).reshape(-1, 3)
    count = int((groups[:, 2] - groups[:, 1]).sum())
    pairs = _pairs(problem, ranges, moving)
    robot = SampledRobot(
        joints=problem.robot_field.joints,
        drivers=np.abs(group.expand_velocity).argmax(axis=1),
        multipliers=group.expand_velocity.sum(axis=1),
        offsets=group.expand_offset,
        points=np.ascontiguousarray(charged.points.T),
        weights=np.full(len(charged.points), WEIGHT / max(count, 1)),
        groups=groups,
        balls=np.array([_ball(charged.points[first:last]) for _, first, last in groups]).reshape(-1, 4),
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


def _point_ranges(problem: Problem) -> list[tuple[int, int]]:
    """First point and one past the last point of every body, in the order of the group's geometry."""
    robot = problem.group.robot
    shapes = robot_charges(robot).shapes
    indices = {shape.name: index for index, shape in enumerate(robot.geometry.geometryObjects)}
    counts = [len(shapes[indices[shape.name]].points) for shape in problem.group.geometry.geometryObjects]
    ends = np.cumsum(counts).tolist()
    return list(zip([0, *ends[:-1]], ends, strict=True))


def _ball(points: np.ndarray) -> np.ndarray:
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    return np.r_[centre, np.linalg.norm(points - centre, axis=1).max()]


def _ignored(problem: Problem, moving: list[int]) -> np.ndarray:
    """Which obstacles don't count for which groups: those that the world doesn't test against the body."""
    bodies, obstacles = problem.group.geometry.ngeoms, len(problem.scene.obstacles)
    ignored = np.ones((bodies, obstacles), bool)
    tested = problem.world.pairs[problem.world.is_obstacle_pair]
    ignored[tested[:, 0], tested[:, 1] - bodies] = False
    return np.ascontiguousarray(ignored[moving])


def _pairs(problem: Problem, ranges: list[tuple[int, int]], moving: list[int]) -> np.ndarray:
    """Group and capsule (k, 2) of the bodies that repel each other and are tested."""
    tested = {(int(a), int(b)) for a, b in problem.world.pairs[: problem.world.n_self]}
    body_of = {first: body for body, (first, _) in enumerate(ranges)}
    group_of = {body: group for group, body in enumerate(moving)}
    pairs = [
        (group_of[body], capsule)
        for first, _, capsule in problem.robot_field.charged.pairs.tolist()
        if (body := body_of[first]) in group_of and (min(body, capsule), max(body, capsule)) in tested
    ]
    return np.array(pairs, np.int64).reshape(-1, 2)


def _freeze(robot: SampledRobot) -> None:
    for array in robot[1:]:
        array.setflags(write=False)
