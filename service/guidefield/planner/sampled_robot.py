"""The robot of a problem as the relaxation's kernels read it: points against obstacles, points against other links."""

from __future__ import annotations

import numpy as np

from guidefield.kernels.distance import DistanceTables
from guidefield.kernels.sampled_robot import SampledRobot
from guidefield.kernels.self_barrier import pair_distances
from guidefield.planner.problem import Problem
from guidefield.robot.link_bodies import link_bodies
from guidefield.robot.surface_samples import surface_samples

WEIGHT = 100.0
"""Sum of the weights of all points."""

SELF_RANGE = 0.03
"""Range of the barrier between links [m]."""

LEAST_SELF_RANGE = 0.004
"""The same between links that are that close at an end of the path."""


COARSER = 3
"""One in so many of a link's points stands for all against other links: the first ones, which are spread as evenly."""


def sampled_robot(problem: Problem, tables: DistanceTables, ends: np.ndarray) -> SampledRobot:
    """The moving links of a problem's robot as points, and the pairs of links that are kept apart.

    Bodies that stand still don't count, nor do pairs that the world doesn't test. Links that are within range of each
    other at an end of the path are let in that far all along it.

    Args:
        problem: Robot, world and field.
        tables: Obstacles.
        ends: Chart points at which links may be as close as they are, shape (m, nv).
    """
    group = problem.group
    moving = [body for body, shape in enumerate(group.geometry.geometryObjects) if shape.parentJoint > 0]
    points = _points(problem, moving)
    counts = np.array([len(some) for some in points], np.int64)
    last = np.cumsum(counts)
    joints = [group.geometry.geometryObjects[body].parentJoint for body in moving]
    links, pairs = _links(problem), _pairs(problem, moving)
    robot = SampledRobot(
        joints=problem.robot_field.joints,
        drivers=np.abs(group.expand_velocity).argmax(axis=1),
        multipliers=group.expand_velocity.sum(axis=1),
        offsets=group.expand_offset,
        origin=group.expand(group.q_origin),
        points=np.ascontiguousarray(np.concatenate([np.empty((0, 3)), *points]).T),
        weights=np.full(int(counts.sum()), WEIGHT / max(int(counts.sum()), 1)),
        groups=np.column_stack(
            [np.array(joints, np.int64), last - counts, last, last - counts + -(-counts // COARSER)]
        ),
        balls=np.array([_ball(some) for some in points]).reshape(-1, 4),
        ignored=_ignored(problem, moving),
        links=links,
        link_joints=np.array([shape.parentJoint for shape in group.geometry.geometryObjects], np.int64),
        link_balls=_balls(links),
        pairs=pairs,
        pair_ranges=np.full(len(pairs), SELF_RANGE),
    )
    _freeze(robot)
    closest = np.full(len(pairs), np.inf)
    for z in ends:
        distances = np.empty(len(pairs))
        pair_distances(robot, tables, np.ascontiguousarray(z), distances)
        closest = np.minimum(closest, distances)
    robot = robot._replace(pair_ranges=np.clip(closest, LEAST_SELF_RANGE, SELF_RANGE))
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


def _balls(links: DistanceTables) -> np.ndarray:
    """Balls about bodies, in the frames of their joints, shape (b, 4)."""
    low, high = links.bounds[:, :3], links.bounds[:, 3:]
    centres = np.einsum("bij,bj->bi", links.placements[:, :, :3], 0.5 * (low + high)) + links.placements[:, :, 3]
    return np.column_stack([centres, 0.5 * np.linalg.norm(high - low, axis=1)])


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
    """Moving body (its place in `moving`) and other body of the robot's own pairs, both ways, shape (k, 2)."""
    place = {body: index for index, body in enumerate(moving)}
    pairs = [
        (place[points], other)
        for first, second in problem.world.pairs[: problem.world.n_self].tolist()
        for points, other in ((first, second), (second, first))
        if points in place
    ]
    return np.array(pairs, np.int64).reshape(-1, 2)


def _links(problem: Problem) -> DistanceTables:
    """The group's bodies in the frames of their joints."""
    shapes, indices = link_bodies(problem.group.robot), _indices(problem)
    placements = [shape.placement.homogeneous[:3] for shape in problem.group.geometry.geometryObjects]
    of_group = {
        name: getattr(shapes, name)[indices] for name in ("kinds", "obstacles", "sizes", "bounds", "boxes", "spans")
    }
    links = shapes._replace(**of_group, placements=np.array(placements).reshape(-1, 3, 4))
    for array in links[:-1]:
        array.setflags(write=False)
    return links


def _freeze(robot: SampledRobot) -> None:
    for name, array in robot._asdict().items():
        if name not in ("joints", "links"):
            array.setflags(write=False)
