"""The first motion of an optimisation: the time-optimal one along a path, as a uniform B-spline within limits."""

from __future__ import annotations

from typing import cast

import numpy as np

from guidefield.kernels.optimize.limit_barrier import MotionLimits
from guidefield.planner.motion.bspline import ENDS, BSpline, End
from guidefield.planner.motion.stopping import ROUNDING
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.motion.waypoints import length_of
from guidefield.planner.optimize.settings import OptimizationSettings
from guidefield.planner.task.problem import Problem
from guidefield.read_only import read_only
from guidefield.robot.model.spaces import ChartPoints, ChartRate


def motion_limits(problem: Problem) -> MotionLimits:
    """What a problem's motions keep."""
    group = problem.group
    jerk = np.full(group.nv, np.inf) if problem.jerk_limits is None else problem.jerk_limits
    if problem.in_motion or problem.scene.moves:  # its time can't be scaled in the end
        jerk = (1.0 - ROUNDING) * jerk
    rows = (group.velocity_limits, group.acceleration_limits, jerk, group.lower, group.upper, group.sizes)
    limits = MotionLimits(*(np.array(row, float) for row in rows))
    read_only(*limits)
    return limits


def ends_of(problem: Problem, motion: Trajectory) -> tuple[End, End]:
    """The states in which a problem's motion begins and ends, where another one does."""
    start, end = motion.positions[0].copy(), motion.positions[-1].copy()
    rise = problem.start_acceleration
    still = cast(ChartRate, np.zeros(problem.group.nv))
    return End(start, problem.start_rates.copy(), still if rise is None else rise.copy()), End(
        end, problem.end_rates.copy(), still
    )


def first_motion(motion: Trajectory, limits: MotionLimits, settings: OptimizationSettings) -> BSpline:
    """A spline near a motion from rest to rest, strictly within limits; slower where it has to be."""
    return _stretched(motion, _pieces(motion, limits, settings), limits, settings)


def scheduled_motion(
    motion: Trajectory, limits: MotionLimits, settings: OptimizationSettings, arrive_from: float
) -> BSpline:
    """A spline near a motion from rest to rest that keeps a schedule, strictly within limits.

    It takes as long, or longer where that is too fast, or too soon. Where it is fastest its pieces are as short as
    those of a motion that speeds up and brakes all the way.

    Args:
        arrive_from: It ends after this [s].
    """
    begin = float(motion.times[0])
    fastest = float(np.linalg.norm(motion.velocities / limits.sizes, axis=1).max())
    pieces = int(np.ceil(0.5 * fastest * motion.duration / settings.piece))
    spline = _stretched(motion, int(np.clip(pieces, settings.least_pieces, settings.most_pieces)), limits, settings)
    step = max(spline.step, max(motion.duration, settings.room * (arrive_from - begin)) / spline.pieces)
    return BSpline.between(spline.start, spline.end, spline.inner, step, begin)


def moving_motion(
    motion: Trajectory, ends: tuple[End, End], limits: MotionLimits, settings: OptimizationSettings
) -> BSpline:
    """A spline near a motion that begins or ends in motion, in short pieces; not yet within limits."""
    speeds = np.maximum(*(np.abs(end.velocity) for end in ends))
    stop = float((speeds / limits.acceleration).max()) / settings.stop_pieces
    step = min(motion.duration / _pieces(motion, limits, settings), 0.5 * longest_step(ends, limits))
    step = min(step, stop) if stop > 0.0 else step
    pieces = int(np.clip(np.ceil(motion.duration / step), settings.least_pieces, settings.most_moving_pieces))
    step = motion.duration / pieces
    times = motion.times[0] + step * np.arange(2, pieces - 1)
    return BSpline.between(*ends, _with_room(motion.evaluate(times)[0], limits, settings), step)


def longest_step(ends: tuple[End, End], limits: MotionLimits) -> float:
    """How long pieces may be for ends that still speed up: the first velocity is v + a h / 2 [s]."""
    longest = np.inf
    for end in ends:
        rises = end.velocity * end.acceleration > 0.0
        room = (limits.velocity - np.abs(end.velocity))[rises]
        longest = min(longest, float((2.0 * room / np.abs(end.acceleration[rises])).min(initial=np.inf)))
    return longest


def _stretched(motion: Trajectory, pieces: int, limits: MotionLimits, settings: OptimizationSettings) -> BSpline:
    """A spline of so many pieces through samples of a motion evenly in time, as fast as it may be with some room."""
    inner = pieces - ENDS  # the ends take the places before and after them
    times = motion.times[0] + motion.duration * np.arange(1, inner + 1) / (inner + 1)
    points = _with_room(motion.evaluate(times)[0], limits, settings)
    start, end = End.at_rest(motion.positions[0].copy()), End.at_rest(motion.positions[-1].copy())
    step = settings.room * shortest_step(BSpline.between(start, end, points, 1.0).points, limits)
    return BSpline.between(start, end, points, step)


def _pieces(motion: Trajectory, limits: MotionLimits, settings: OptimizationSettings) -> int:
    """How many pieces a motion has."""
    length = length_of(motion.positions, limits.sizes)
    return int(np.clip(np.ceil(length / settings.piece), settings.least_pieces, settings.most_pieces))


def _with_room(points: ChartPoints, limits: MotionLimits, settings: OptimizationSettings) -> ChartPoints:
    """Control points (n, nv) brought strictly within the range of positions."""
    room = np.where(np.isfinite(limits.upper - limits.lower), settings.inside * (limits.upper - limits.lower), 0.0)
    within = points.copy()
    np.clip(points, limits.lower + room, limits.upper - room, out=within)
    return within


def load_of(spline: BSpline, limits: MotionLimits) -> float:
    """The largest share of a limit that a spline's inner differences take: below 1 it is strictly within limits."""
    load, differences = 0.0, spline.points
    for order, limit in enumerate((limits.velocity, limits.acceleration, limits.jerk), 1):
        differences = np.diff(differences, axis=0)
        given = ENDS - order  # the ends' own
        inner = differences[given : len(differences) - given]
        load = max(load, float((np.abs(inner) / (limit * spline.step**order)).max()))
    return load


def shortest_step(points: ChartPoints, limits: MotionLimits) -> float:
    """The length of pieces with which control points (n, nv) reach the limits of their ratios [s]."""
    first = np.diff(points, axis=0)
    second = np.diff(first, axis=0)
    third = np.diff(second, axis=0)
    return max(
        float((np.abs(first) / limits.velocity).max()),
        float(np.sqrt((np.abs(second) / limits.acceleration).max())),
        float(np.cbrt((np.abs(third) / limits.jerk).max())),
    )
