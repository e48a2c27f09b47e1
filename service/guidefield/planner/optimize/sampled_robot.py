"""The robot as the barrier's kernels read it (`SampledRobot`): points against obstacles and against other links."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from guidefield.collision.clearance import clearance_at
from guidefield.kernels.barrier.sampled_robot import FIRST, JOINT, PAST, PAST_FEW, SampledRobot
from guidefield.kernels.barrier.self_barrier import pair_distances
from guidefield.kernels.distance.distance import DistanceTables
from guidefield.kernels.simd.vector import LANES_64
from guidefield.planner.task.problem import Problem
from guidefield.prove.verdict import Verdict
from guidefield.read_only import ReadOnly, read_only
from guidefield.robot.bodies.charges import link_bodies, surface_samples
from guidefield.robot.group.group import PlanningGroup, memoized_for_alike
from guidefield.robot.group.kinematics import alike_group_joints, group_joints
from guidefield.robot.model.spaces import ChartPoints

POINTS_WEIGHT = 100.0  # sum of the weights of all points. Unrecorded
RANGE = 0.03  # of the barrier between links [m], at size 1. Unrecorded
LEAST_RANGE = 0.004  # the same between links that are that close at an end of the motion [m]. Unrecorded
COARSER = 3  # one in this many of a link's points represents all against other links. Unrecorded
TOUCHED_WEIGHT = 8.0  # a point at which the certificate refused a motion counts as this many. A choice


def sampled_robot(problem: Problem, tables: DistanceTables, ends: ChartPoints) -> SampledRobot:
    """The moving links of a problem's robot as points, and the pairs of links that are kept apart.

    Bodies that stand still don't count, nor do pairs that the world doesn't test. Links that are within range of each
    other at an end (m, nv) of the motion are let in that far all along it.
    """
    moving, pairs = _moving(problem.group), _pairs(problem.group, problem.world.pairs.own.tobytes())
    robot = _of_group(problem.group)._replace(
        joints=group_joints(problem.group),
        ignored=_ignored(problem, moving),
        pairs=pairs,
        pair_ranges=np.full(len(pairs), RANGE * problem.group.size),
    )
    read_only(robot.ignored, robot.pair_ranges)
    closest = np.full(len(pairs), np.inf)
    for z in ends:
        distances = np.empty(len(pairs))
        pair_distances(robot, tables, np.ascontiguousarray(z), distances)
        closest = np.minimum(closest, distances)
    least, most = (length * problem.group.size for length in (LEAST_RANGE, RANGE))
    ranges = np.minimum(np.maximum(closest, least), most)
    read_only(ranges)
    return robot._replace(pair_ranges=ranges)


@dataclass(frozen=True, eq=False)
class TouchedPoint(ReadOnly):
    """A point of a moving link at which the certificate refused a motion."""

    body: int
    point: np.ndarray  # where it is, shape (3,), in the frame of the body's joint [m]
    other: int  # the robot's other body, where it touched that; -1 where it touched an obstacle


def touched_points(problem: Problem, verdict: Verdict) -> list[TouchedPoint]:
    """Find the closest points of the pair that a verdict refused, where it was judged, among obstacles at rest."""
    if verdict.pair is None or verdict.chart_point is None or problem.scene.moves:
        return []
    world = problem.world
    closest = clearance_at(world, problem.group.expand_from_chart(verdict.chart_point))
    of_kinds = (
        (closest.obstacle_pair, closest.pairs[1], closest.witness),
        (closest.self_pair, closest.pairs[0], closest.self_witness),
    )
    found = []
    for names, pair, witness in of_kinds:
        if names is None or witness is None or set(names) != set(verdict.pair):
            continue
        bodies, links = world.pairs.of(pair), world.pairs.links
        for body, other, point in zip(bodies, bodies[::-1], witness, strict=True):
            if body < links and (joint := world.bodies.joints[body]) > 0:
                at = world.data.oMi[int(joint)].actInv(point)
                found.append(TouchedPoint(body, at, other if other < links else -1))
    return found


def with_points(problem: Problem, robot: SampledRobot, touched: Sequence[TouchedPoint]) -> SampledRobot:
    """The same robot with more points, each a group of its own that counts as several."""
    moving = _moving(problem.group)
    for one in touched:
        group, count = moving.index(one.body), robot.points.shape[1]
        pairs, ranges = robot.pairs, robot.pair_ranges
        if one.other >= 0:
            pairs = np.concatenate([pairs, [[len(robot.groups), one.other]]])
            ranges = np.append(ranges, RANGE * robot.size)
        ball = np.append(one.point, 0.0)
        robot = robot._replace(
            points=np.column_stack([robot.points, one.point]),
            weights=np.append(robot.weights, TOUCHED_WEIGHT * robot.weights.mean()),
            groups=np.concatenate([robot.groups, [[robot.groups[group, JOINT], count, count + 1, count + 1]]]),
            balls=np.concatenate([robot.balls, ball[None]]),
            blocks=np.column_stack([robot.blocks, ball]),
            first_blocks=np.append(robot.first_blocks, robot.blocks.shape[1]),
            ignored=np.concatenate([robot.ignored, robot.ignored[group : group + 1]]),
            pairs=pairs,
            pair_ranges=ranges,
        )
    read_only(*robot)
    return robot


def few_points(robot: SampledRobot) -> SampledRobot:
    """The same robot with the few points of each link alone that stand for all against links, weighing as much."""
    groups, weights = robot.groups.copy(), robot.weights.copy()
    groups[:, PAST] = robot.groups[:, PAST_FEW]
    for first, past, past_few in robot.groups[:, [FIRST, PAST, PAST_FEW]]:
        weights[first:past] *= (past - first) / max(past_few - first, 1)
    read_only(groups, weights)
    return robot._replace(groups=groups, weights=weights)


@memoized_for_alike
def _of_group(group: PlanningGroup) -> SampledRobot:
    moving = _moving(group)
    points = [in_blocks(some, -(-len(some) // COARSER)) for some in _points(group, moving)]
    counts = np.array([len(some) for some in points], np.int64)
    blocks = [_balls_about(some, LANES_64) for some in points]
    last = np.cumsum(counts)
    joints = [group.geometry.geometryObjects[body].parentJoint for body in moving]
    links = _links(group)
    robot = SampledRobot(
        joints=alike_group_joints(group),
        points=np.ascontiguousarray(np.concatenate([np.empty((0, 3)), *points]).T),
        weights=np.full(int(counts.sum()), POINTS_WEIGHT / max(int(counts.sum()), 1)),
        groups=np.column_stack(
            [np.array(joints, np.int64), last - counts, last, last - counts + -(-counts // COARSER)]
        ),
        balls=np.concatenate([np.empty((0, 4)), *(_balls_about(some, len(some)) for some in points)]),
        blocks=np.ascontiguousarray(np.concatenate([np.empty((0, 4)), *blocks]).T),
        first_blocks=np.cumsum([0, *map(len, blocks)])[:-1],
        ignored=np.empty((len(moving), 0), bool),
        links=links,
        link_joints=np.array([shape.parentJoint for shape in group.geometry.geometryObjects], np.int64),
        link_balls=_balls(links),
        pairs=np.empty((0, 2), np.int64),
        pair_ranges=np.empty(0),
        size=group.size,
    )
    read_only(*robot)
    return robot


def in_blocks(points: np.ndarray, few: int) -> np.ndarray:
    """Points (n, 3) of a link, the first few of them first, ordered so that each block of lanes is of neighbours."""
    return np.concatenate([_by_place(points[:few]), _by_place(points[few:])])


def _by_place(points: np.ndarray) -> np.ndarray:
    """Points (n, 3), halved across their longest extent until they are blocks; all but the last are whole."""
    if len(points) <= LANES_64:
        return points
    along = points[:, np.argmax(np.ptp(points, axis=0))].argsort(kind="stable")
    half = LANES_64 * (-(-len(points) // LANES_64) // 2)
    return np.concatenate([_by_place(points[along[:half]]), _by_place(points[along[half:]])])


@memoized_for_alike
def _moving(group: PlanningGroup) -> tuple[int, ...]:
    return tuple(body for body, shape in enumerate(group.geometry.geometryObjects) if shape.parentJoint > 0)


def _indices(group: PlanningGroup) -> list[int]:
    indices = {shape.name: index for index, shape in enumerate(group.robot.geometry.geometryObjects)}
    return [indices[shape.name] for shape in group.geometry.geometryObjects]


def _points(group: PlanningGroup, moving: tuple[int, ...]) -> list[np.ndarray]:
    """Points of every moving body, each (n, 3) in the frame of its joint [m]."""
    samples, indices = surface_samples(group.robot), _indices(group)
    placements = [group.geometry.geometryObjects[body].placement for body in moving]
    return [
        samples[indices[body]] @ placement.rotation.T + placement.translation
        for body, placement in zip(moving, placements, strict=True)
    ]


def _balls(links: DistanceTables) -> np.ndarray:
    """Balls about bodies, in the frames of their joints, shape (b, 4)."""
    low, high = links.bounds[:, :3], links.bounds[:, 3:]
    centres = np.einsum("bij,bj->bi", links.placements[:, :, :3], 0.5 * (low + high)) + links.placements[:, :, 3]
    return np.column_stack([centres, 0.5 * np.linalg.norm(high - low, axis=1)])


def _balls_about(points: np.ndarray, every: int) -> np.ndarray:
    """Centre and radius of a ball about each group of some points (n, 3), n > 0: shape (balls, 4)."""
    first = np.arange(0, len(points), every)
    centres = 0.5 * (np.minimum.reduceat(points, first) + np.maximum.reduceat(points, first))
    away = np.linalg.norm(points - centres[np.arange(len(points)) // every], axis=1)
    return np.column_stack([centres, np.maximum.reduceat(away, first)])


def _ignored(problem: Problem, moving: tuple[int, ...]) -> np.ndarray:
    pairs = problem.world.pairs
    ignored = np.ones((pairs.links, pairs.obstacles), bool)
    ignored[pairs.moving] = False
    ignored[tuple(pairs.bodies_left_out().T)] = True
    return np.ascontiguousarray(ignored[list(moving)])


@memoized_for_alike
def _pairs(group: PlanningGroup, own_pairs: bytes) -> np.ndarray:
    """Moving body (its place among them) and other body of own pairs (own, 2) of int64, both ways, shape (k, 2)."""
    moving, own = list(_moving(group)), np.frombuffer(own_pairs, np.int64).reshape(-1, 2)
    place = np.full(len(group.geometry.geometryObjects), -1)
    place[moving] = np.arange(len(moving))
    both = np.stack([own, own[:, ::-1]], axis=1).reshape(-1, 2)  # arrays, as a chain of 96 links has 9,120 rows
    there = place[both[:, 0]] >= 0
    pairs = np.column_stack([place[both[there, 0]], both[there, 1]]).astype(np.int64)
    read_only(pairs)
    return pairs


def _links(group: PlanningGroup) -> DistanceTables:
    shapes, indices = link_bodies(group.robot), _indices(group)
    placements = [shape.placement.homogeneous[:3] for shape in group.geometry.geometryObjects]
    of_group = {
        name: getattr(shapes, name)[indices] for name in ("kinds", "obstacles", "sizes", "bounds", "boxes", "spans")
    }
    links = shapes._replace(**of_group, placements=np.array(placements).reshape(-1, 3, 4))
    read_only(*links[:-2])
    return links
