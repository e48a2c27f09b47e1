"""Samples along a motion, at which distances to obstacles and path constraints are taken, and comparison by them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from guidefield.kernels.barrier.obstacle_barrier import moving_distance, nothing_remembered, obstacle_distance
from guidefield.kernels.barrier.sampled_robot import SampledRobot
from guidefield.kernels.optimize.clearance_model import MotionSamples, clearance_along
from guidefield.kernels.optimize.constraint_penalty import KeptSamples
from guidefield.memo import memoized_by_value
from guidefield.planner.motion.bspline import BSpline, basis
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.optimize.sampled_robot import sampled_robot
from guidefield.planner.optimize.settings import OptimizationSettings
from guidefield.planner.task.problem import Problem
from guidefield.read_only import ReadOnly, read_only
from guidefield.robot.group.group import PlanningGroup, memoized_for_alike
from guidefield.robot.group.path_constraints import ConstrainedFrames, keep_frames
from guidefield.robot.model.spaces import ChartPoint, ChartPoints
from guidefield.scene.distance_tables import distance_tables, moving_tables

LEAST_RANGE_SHARE = 0.5  # share of the range at an end: what is that close by cannot be left
RAMP = 0.5  # joint distance from an end at which the range is the full one [rad or m]. Unrecorded
FLOOR_SHARE = 1.1  # the floor at an end, as a share of the end's distance from obstacles
FLOOR_RAMP = 0.3  # joint distance from an end at which the floor is the full one [rad or m]. Unrecorded
# share of a path constraint's limit up to which it costs nothing. By 33 problems of `tools/bench constrained`, as what
# follows: with 0.85 certificates take twice the time
CONSTRAINT_ROOM = 0.7
CONSTRAINT_WEIGHT = 3e3  # weight of half the mean square of what is beyond. With 300 some are refused
CONSTRAINT_SAMPLES = 2  # samples for each at which the clearance is examined. Unrecorded
COMPARED = 64  # samples at which two motions among obstacles that move are compared. A choice
# limits of path constraints up to this count in Newton's steps all through [rad or m]. With 0 one in six motions hardly
# gets shorter, with 0.02 and 0.05 they are the same
TIGHT = 0.03
FARTHEST = 0.25  # largest distance that counts of an end from obstacles [m], at size 1. Unrecorded
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
    too. `kept` is what start and end keep from obstacles, the clearance what is asked for [m].
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
) -> tuple[MotionSamples, ChartPoints]:
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
    return placed, cast(ChartPoints, np.concatenate([points, points[-3:]]))


def _counts(
    zs: ChartPoints, kept: tuple[float, float], clearance: float, settings: OptimizationSettings, *, in_time: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weights, ranges and floors of samples between chart points over their sizes (s + 1, nv), each of shape (s,)."""
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
    asked: np.ndarray  # whether each is examined on a section, 1 or 0, shape (sections, k)

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
    asked = sections.asked[np.searchsorted(np.array(passed), bounds[:-1], side="right")]
    asked.setflags(write=False)
    return KeptSamples(
        keep_frames(sections.frames),
        of_samples,
        shares,
        sections.groups,
        asked,
        CONSTRAINT_ROOM,
        CONSTRAINT_WEIGHT,
        TIGHT,
    )


@memoized_for_alike
def _no_samples(group: PlanningGroup) -> KeptSamples:
    nowhere, none = place_samples(0, 1), Sections.whole(ConstrainedFrames(group, ()))
    return KeptSamples(keep_frames(none.frames), nowhere[2], nowhere[3], none.groups, none.asked[:0], 1.0, 0.0, 0.0)


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


def keeps_aside(problem: Problem, motion: Trajectory, distance: float) -> bool:
    """Return whether the robot's points keep a distance [m] from all that moves, at samples of a motion.

    Where they don't no certificate says that the robot keeps it; where they do it has to be asked.
    """
    tables, moving = distance_tables(problem.scene), moving_tables(problem.scene)
    robot = sampled_robot(problem, tables, motion.positions[:0])
    count = math.ceil(motion.duration / SPACING) + 1
    times = np.linspace(float(motion.times[0]), float(motion.times[-1]), count)
    places = zip(motion.evaluate(times)[0], times.tolist(), strict=True)
    return all(moving_distance(robot, moving, z, time, distance) >= distance for z, time in places)


def kept_at(problem: Problem, robot: SampledRobot, z: ChartPoint, time: float) -> float:
    """Distance from obstacles at a chart point (nv,) and a time [s], at most `FARTHEST` at the robot's size [m]."""
    z, most = np.ascontiguousarray(z), FARTHEST * problem.group.size
    at_rest = obstacle_distance(robot, distance_tables(problem.scene), z, most)
    if not problem.scene.moves:
        return at_rest
    return min(at_rest, moving_distance(robot, moving_tables(problem.scene), z, time, most))
