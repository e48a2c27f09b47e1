"""The robot as points, as the barrier's kernels read it, and samples of a motion at which its clearance is taken.

All of it is the objective of the optimisation, a proposal: the constants change the motion that comes out, how often
the certificate refuses it, and the time; service/docs/algorithm.md, "Optimise", repeats `LEAST_RANGE_SHARE`,
`CONSTRAINT_ROOM` and half of `CONSTRAINT_WEIGHT`. The order of points (the few of a link first, by SIMD batches) is the
kernels' (kernels/optimize/barrier.py).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from guidefield.collision.clearance import clearance_at
from guidefield.kernels.distance.distance import DistanceTables
from guidefield.kernels.optimize.barrier import FIRST, JOINT, PAST, PAST_FEW, SampledRobot
from guidefield.kernels.optimize.clearance_model import MotionSamples, clearance_along
from guidefield.kernels.optimize.obstacle_barrier import moving_distance, nothing_remembered, obstacle_distance
from guidefield.kernels.optimize.penalties import KeptSamples
from guidefield.kernels.optimize.robot_barrier import pair_distances
from guidefield.kernels.simd.vector import LANES_64
from guidefield.memo import memoized_by_value
from guidefield.planner.motion.bspline import BSpline, basis
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.optimize.settings import OptimizationSettings
from guidefield.planner.task.problem import Problem
from guidefield.prove.verdict import Verdict
from guidefield.read_only import ReadOnly, read_only
from guidefield.robot.group.group import PlanningGroup, memoized_for_alike
from guidefield.robot.group.kinematics import alike_group_joints, group_joints
from guidefield.robot.group.path_constraints import ConstrainedFrames, keep_frames
from guidefield.robot.link_charges import link_bodies, surface_samples
from guidefield.robot.model.joints import LocalPoint, LocalPoints
from guidefield.scene.distance_tables import distance_tables, moving_tables

POINTS_WEIGHT = 100.0  # sum of the weights of all points. Unrecorded
RANGE = 0.03  # of the barrier between links [m], at size 1. Unrecorded
LEAST_RANGE = 0.004  # the same between links that are that close at an end of the motion [m]. Unrecorded
COARSER = 3  # one in this many of a link's points represents all against other links. Unrecorded
TOUCHED_WEIGHT = 8.0  # a point at which the certificate refused a motion counts as this many. A choice


def sampled_robot(problem: Problem, tables: DistanceTables, ends: LocalPoints) -> SampledRobot:
    """The moving links of a problem's robot as points, and the pairs of links that are kept apart.

    Bodies that stand still don't count, nor do pairs that the world doesn't test. Links that are within range of each
    other at an end (m, nv) of the motion are let in that far all along it.
    """
    moving, pairs = _moving(problem.group), _pairs(problem.group, problem.world.pairs.own.tobytes())
    robot = _of_group(problem.group)._replace(
        joints=group_joints(problem.group),
        ignored=_ignored_pairs(problem, moving),
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
    """Find the closest points of the pair that a verdict refused, at its place, among obstacles at rest."""
    if verdict.pair is None or verdict.local_point is None or problem.scene.moves:
        return []
    world = problem.world
    closest = clearance_at(world, problem.group.expand_from_local(verdict.local_point))
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
    """Points (n, 3) of a link, the first few of them first, ordered so that each SIMD batch has neighbours."""
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


def _ignored_pairs(problem: Problem, moving: tuple[int, ...]) -> np.ndarray:
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


LEAST_RANGE_SHARE = 0.5  # share of the range at an end: what is that close by cannot be left
RAMP = 0.5  # joint distance from an end at which the range is the full one [rad or m]. Unrecorded
FLOOR_SHARE = 1.1  # the floor at an end, as a share of the end's distance from obstacles
FLOOR_RAMP = 0.3  # joint distance from an end at which the floor is the full one [rad or m]. Unrecorded
# share of a path constraint's limit up to which it costs nothing. By 33 random problems among boxes, as what
# follows: with 0.85 certificates take twice the time
CONSTRAINT_ROOM = 0.7
CONSTRAINT_WEIGHT = 3e3  # weight of half the mean square of what is beyond. With 300 some are refused
CONSTRAINT_SAMPLES = 2  # samples for each at which the clearance is examined. Unrecorded
COMPARED = 64  # samples at which two motions among obstacles that move are compared. A choice
# limits of path constraints up to this count in Newton's steps all through [rad or m]. With 0 one in six motions hardly
# gets shorter, with 0.02 and 0.05 they are the same
TIGHT = 0.03
FARTHEST = 0.25  # most that counts of an end's distance [m], at size 1: caps floors at `FLOOR_SHARE` of it. Unrecorded
SPACING = 0.05  # of samples at which a motion's distance from what moves is checked [s]. A choice


def clearance_samples(
    spline: BSpline,
    kept: tuple[float, float],
    clearance: float,
    samples: int,
    settings: OptimizationSettings,
    sizes: np.ndarray,
    *,
    in_time: bool = False,
) -> MotionSamples:
    """Samples evenly in time, each of which counts by the joint distance, over sizes (nv,), that it represents.

    Where obstacles move it counts by half of that, and half of its share of time: they come to a robot that stands,
    too. `kept` is what start and end keep from obstacles, `clearance` the required distance [m].
    """
    bounds, middles, pieces, of_pieces, shares = place_samples(spline.pieces, samples)
    counts = _counts(spline.at(bounds) / sizes, kept, clearance, settings, in_time=in_time)
    placed = MotionSamples(pieces, middles, of_pieces, *counts, shares)
    read_only(*placed)
    return placed


def samples_in_time(
    motion: Trajectory,
    kept: tuple[float, float],
    clearance: float,
    samples: int,
    settings: OptimizationSettings,
    sizes: np.ndarray,
) -> tuple[MotionSamples, LocalPoints]:
    """As `clearance_samples`, of a motion that is no spline, among what moves; and control points (samples + 3, nv).

    There is one for each sample, and places are times [s].
    """
    bounds = motion.times[0] + motion.duration * np.arange(samples + 1) / samples
    middles = 0.5 * (bounds[:-1] + bounds[1:])
    counts = _counts(motion.evaluate(bounds)[0] / sizes, kept, clearance, settings, in_time=True)
    each = np.tile([1.0, 0.0, 0.0, 0.0], (samples, 1))
    placed = MotionSamples(np.arange(samples), middles, each, *counts, np.ones(samples))
    read_only(*placed)
    points = motion.evaluate(middles)[0]
    return placed, cast(LocalPoints, np.concatenate([points, points[-3:]]))


def _counts(
    zs: LocalPoints, kept: tuple[float, float], clearance: float, settings: OptimizationSettings, *, in_time: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weights, ranges and floors of samples between coordinates over their sizes (s + 1, nv), each of shape (s,)."""
    steps = zs[1:] - zs[:-1]
    lengths = np.sqrt((steps * steps).sum(axis=1))
    total = max(float(lengths.sum()), 1e-300)
    until = np.cumsum(lengths) - 0.5 * lengths
    from_end = np.minimum(until, total - until)
    near = np.minimum(from_end / RAMP, 1.0)
    least = np.where(until < 0.5 * total, *(_floor(one, settings) for one in kept))
    rise = np.minimum(from_end / FLOOR_RAMP, 1.0) ** 2
    stands_for = 0.5 * (lengths + total / len(lengths)) if in_time else lengths
    far = min(max(FLOOR_SHARE * min(kept), settings.floor), settings.farthest_floor) + clearance
    return (
        settings.weight / total * stands_for * (1.0 + settings.end_weight * (1.0 - near)),
        settings.range * (LEAST_RANGE_SHARE + (1.0 - LEAST_RANGE_SHARE) * near),
        least + (np.maximum(far, least) - least) * rise,
    )


def _floor(kept: float, settings: OptimizationSettings) -> float:
    """The distance below which points cost more at an end that keeps a distance from obstacles [m]."""
    return min(max(FLOOR_SHARE * kept, settings.least_floor), settings.floor)


@memoized_by_value(256)
def place_samples(pieces: int, samples: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Place samples on each of some pieces, in pieces from the start.

    Returns the bounds between them, shape (s + 1,); where each is, shape (s,), and its piece; the basis there, shape
    (s, 4); how much each counts between links, shape (s,).
    """
    bounds = np.arange(pieces * samples + 1) / samples
    middles = 0.5 * (bounds[:-1] + bounds[1:])
    of_samples = middles.astype(np.int64)
    shares = np.where(np.arange(pieces * samples) % 2 == 0, 2.0, 0.0)
    made = bounds, middles, of_samples, basis(middles - of_samples), shares
    read_only(*made)
    return made


@dataclass(frozen=True, eq=False)
class Sections(ReadOnly):
    """Path constraints, and where they hold along a motion.

    A motion has a section before its first passage, one between each and the next, and one after the last. Some
    constraints hold all along; others are groups of alternatives, one of which holds at any time.
    """

    frames: ConstrainedFrames
    # which group each is of, in ascending order, shape (k,); -1: it holds all along. Of groups that cost as little the
    # first is kept
    groups: np.ndarray
    active: np.ndarray  # whether each is examined on a section, 1 or 0, shape (sections, k)

    @classmethod
    def whole(cls, frames: ConstrainedFrames, passages: int = 0) -> Sections:
        """Constraints that hold all along a motion with a given number of passages."""
        count = len(frames.constraints)
        return cls(frames, np.full(count, -1, np.int64), np.ones((passages + 1, count), np.int64))


def constraint_samples(sections: Sections, pieces: int, passed: Sequence[float], samples: int) -> KeptSamples:
    """Samples evenly in time, next to those of the clearance and between them.

    Args:
        passed: Where it comes nearest to each passage, in pieces from the start.
    """
    if not sections.frames.constraints:
        return _no_samples(sections.frames.group)
    bounds, _, of_samples, shares, _ = place_samples(pieces, CONSTRAINT_SAMPLES * samples)
    active = sections.active[np.searchsorted(np.array(passed), bounds[:-1], side="right")]
    active.setflags(write=False)
    return KeptSamples(
        keep_frames(sections.frames),
        of_samples,
        shares,
        sections.groups,
        active,
        CONSTRAINT_ROOM,
        CONSTRAINT_WEIGHT,
        TIGHT,
    )


@memoized_for_alike
def _no_samples(group: PlanningGroup) -> KeptSamples:
    nowhere, none = place_samples(0, 1), Sections.whole(ConstrainedFrames(group, ()))
    return KeptSamples(keep_frames(none.frames), nowhere[2], nowhere[3], none.groups, none.active[:0], 1.0, 0.0, 0.0)


def is_better(problem: Problem, motion: Trajectory, other: Trajectory, settings: OptimizationSettings) -> bool:
    """Return whether a motion's objective is below another's of the same ends: arrival and clearance as optimised."""
    tables, moving, ends = distance_tables(problem.scene), moving_tables(problem.scene), other.positions[[0, -1]]
    robot = sampled_robot(problem, tables, ends)
    kept = [kept_at(problem, robot, z, time) for z, time in zip(ends, other.times[[0, -1]].tolist(), strict=True)]
    values = []
    for one in (motion, other):
        samples, points = samples_in_time(
            one, (kept[0], kept[1]), problem.min_clearance, COMPARED, settings, problem.group.sizes
        )
        n, nv = points.shape
        clearance, _ = clearance_along(
            robot,
            tables,
            moving,
            samples,
            points,
            1.0,
            0.0,
            problem.min_clearance,
            math.inf,
            nothing_remembered(COMPARED, len(robot.groups)),
            np.empty((n, nv)),
            np.empty(COMPARED, np.int64),
            np.empty((COMPARED, 4)),
            np.empty((COMPARED, nv, nv)),
            np.empty((2, n, nv)),
            np.empty(2),
            np.empty((2, 2)),
        )
        values.append(float(one.times[-1]) / other.duration + clearance)
    return values[0] < values[1]


def keeps_distance(problem: Problem, motion: Trajectory, distance: float) -> bool:
    """Return whether the robot's points keep a distance [m] from all that moves, at samples of a motion.

    If they don't, no certificate can say that the robot keeps it; if they do, only a certificate can.
    """
    tables, moving = distance_tables(problem.scene), moving_tables(problem.scene)
    robot = sampled_robot(problem, tables, motion.positions[:0])
    count = math.ceil(motion.duration / SPACING) + 1
    times = np.linspace(float(motion.times[0]), float(motion.times[-1]), count)
    places = zip(motion.evaluate(times)[0], times.tolist(), strict=True)
    return all(moving_distance(robot, moving, z, time, distance) >= distance for z, time in places)


def kept_at(problem: Problem, robot: SampledRobot, z: LocalPoint, time: float) -> float:
    """Distance from obstacles at local coordinates (nv,) and a time [s], at most `FARTHEST` at the robot's size [m]."""
    z, most = np.ascontiguousarray(z), FARTHEST * problem.group.size
    at_rest = obstacle_distance(robot, distance_tables(problem.scene), z, most)
    if not problem.scene.moves:
        return at_rest
    return min(at_rest, moving_distance(robot, moving_tables(problem.scene), z, time, most))
