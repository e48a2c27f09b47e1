"""The motion that keeps a schedule: along the same path at other times, within the limits of rates exactly.

Its curve is beside the path a little, so it is certified anew. `KNOTS` may be changed, for a motion closer to the
schedule or fewer pieces; `ROUNDING` has to stay below `LIMIT_TOLERANCE` of prove/verdict.py, the certificate's.
"""

from __future__ import annotations

import math
from typing import cast

import numpy as np

from guidefield.planner.motion.limit_load import TOLERANCE, measure_limit_load
from guidefield.planner.motion.timing import SHORTEST_PIECE
from guidefield.planner.motion.trajectory import Trajectory, bezier
from guidefield.planner.schedule.schedule import Schedule
from guidefield.planner.task.problem import Problem
from guidefield.prove.curve import excesses
from guidefield.robot.model.spaces import ChartPoint, ChartPoints, ChartRate, ChartRates

ROUNDING = 1e-12  # a curve that is beyond a limit by no more than this keeps it [rad or m]


def find_leaving(
    knots: np.ndarray, values: ChartPoints, slopes: ChartRates, lower: ChartPoint, upper: ChartPoint
) -> np.ndarray:
    """Find coordinates of a Hermite curve, knots (n,), values and slopes (n, c), that leave limits (c,): shape (c,)."""
    beyond, _ = excesses(bezier(knots, values, slopes), lower, upper)
    left: np.ndarray = np.any(beyond > ROUNDING, axis=0)
    return left


def clamp_smoothly(
    knots: np.ndarray, values: ChartPoints, slopes: ChartRates, lower: ChartPoint, upper: ChartPoint
) -> tuple[ChartPoints, ChartRates]:
    """A C² cubic curve as of `find_leaving` brought within limits, still C²: values and slopes (n, c), its ends kept.

    Its de Boor points are brought within, in whose hull it is. With steps h, that of knot i is b - (h_{i-1} / h_i) (c -
    b), b and c being the inner control points of the piece that begins there (Farin, Curves and Surfaces for CAGD,
    2002, chapter 8).
    """
    h, inner = np.diff(knots)[:, None], bezier(knots, values, slopes)[:, 1:3]
    before, after = np.vstack([np.zeros(1), h]), np.vstack([h, np.zeros(1)])  # steps about each knot
    points = inner[:, 0] - before[:-1] / h * (inner[:, 1] - inner[:, 0])
    points = np.clip(np.vstack([points, inner[-1:, 1]]), lower, upper)
    along = np.diff(points, axis=0) / (before[:-1] + h + after[1:])
    first, second = points[:-1] + before[:-1] * along, points[:-1] + (before[:-1] + h) * along
    kept = values.copy()
    kept[1:-1] = second[:-1] + h[:-1] / (h[:-1] + h[1:]) * (first[1:] - second[:-1])
    rates = np.vstack([(first - kept[:-1]) / h, (kept[-1:] - second[-1:]) / h[-1:]])
    return kept, 3.0 * rates


def bound_slopes(
    knots: np.ndarray, values: ChartPoints, slopes: ChartRates, lower: ChartPoint, upper: ChartPoint
) -> ChartRates:
    """Slopes (n, c) with which a cubic Hermite curve through values as of `find_leaving` keeps limits; not always C².

    The control points next to a knot, a third of a step along the slope away from its value, are brought within.
    """
    thirds = np.diff(knots)[:, None] / 3.0
    above, below = np.maximum(upper - values, 0.0), np.maximum(values - lower, 0.0)
    most, least = np.full(values.shape, np.inf), np.full(values.shape, -np.inf)
    most[:-1], least[:-1] = above[:-1] / thirds, -below[:-1] / thirds
    most[1:], least[1:] = np.minimum(most[1:], below[1:] / thirds), np.maximum(least[1:], -above[1:] / thirds)
    bounded: ChartRates = np.clip(slopes, least, most)
    return bounded


def fit_smooth_spline(times: np.ndarray, positions: ChartPoints) -> tuple[ChartPoints, ChartRates]:
    """Positions and velocities (n, nv) of the C² cubic through points at even times, at rest at both ends.

    No acceleration at an end takes away the freedom of the point next to it, which moves a little. With step h and
    v = 0 at both ends the velocities solve v_{i-1} + 4 v_i + v_{i+1} = 3 (q_{i+1} - q_{i-1}) / h; q_1 = q_0 + h v_1 / 3
    makes the acceleration at the start vanish, and the same holds at the end.
    """
    n, h = len(times), float(times[1] - times[0])
    right = 3.0 * (positions[2:] - positions[:-2]) / h
    lower, upper = np.ones(n - 2), np.ones(n - 2)
    lower[1], right[1] = 2.0, 3.0 * (positions[3] - positions[0]) / h
    upper[-2], right[-2] = 2.0, 3.0 * (positions[-1] - positions[-4]) / h
    velocities = cast(ChartRates, np.zeros_like(positions))
    velocities[1:-1] = _tridiagonal(lower, 4.0, upper, right)
    moved = positions.copy()
    moved[1] = positions[0] + h * velocities[1] / 3.0
    moved[-2] = positions[-1] - h * velocities[-2] / 3.0
    return moved, velocities


def _tridiagonal(lower: np.ndarray, diagonal: float, upper: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve a diagonally dominant tridiagonal system for several right-hand sides (n, c), by Thomas' algorithm."""
    n = len(right)
    pivots, solution = np.full(n, diagonal), right.copy()
    for i in range(1, n):
        ratio = lower[i] / pivots[i - 1]
        pivots[i] -= ratio * upper[i - 1]
        solution[i] -= ratio * solution[i - 1]
    solution[-1] /= pivots[-1]
    for i in range(n - 2, -1, -1):
        solution[i] = (solution[i] - upper[i] * solution[i + 1]) / pivots[i]
    return solution


KNOTS = 8  # knots in a step: with more the rate is followed more closely, by more pieces to certify

Knots = tuple[np.ndarray, ChartPoints, ChartRates]


def retime(problem: Problem, schedule: Schedule) -> Trajectory | None:
    """The motion of a schedule, from time 0 on; None where its changes of rate exceed a limit.

    Where the rate never changes it is the schedule's motion later, and perhaps slower, bit for bit the same curve.
    Else the rate is averaged over a step, so that accelerations are continuous where those of the schedule's motion
    are.
    """
    motion = schedule.motion
    if schedule.constant:
        rate = float(schedule.rates[0])
        times = (motion.times - motion.times[0]) / rate
        return wait_until_begin(Trajectory(schedule.departure + times, motion.positions, motion.velocities * rate))
    knots = (
        _through_samples(problem, schedule) if problem.jerk_limits is not None else _through_knots(problem, schedule)
    )
    group = problem.group
    jerks = cast(ChartRate, np.full(group.nv, np.inf)) if problem.jerk_limits is None else problem.jerk_limits
    if measure_limit_load(*knots, group.velocity_limits, group.acceleration_limits, jerks) > 1.0 + TOLERANCE:
        return None
    times, positions, velocities = knots
    return wait_until_begin(Trajectory(schedule.departure + times, positions, velocities))


def _sample(schedule: Schedule, times: np.ndarray) -> tuple[ChartPoints, ChartRates]:
    motion = schedule.motion
    own, rates = schedule.at(times, schedule.step)
    own = np.clip(own * (motion.duration / own[-1]), 0.0, motion.duration) + motion.times[0]
    positions, velocities, _ = motion.evaluate(own)
    return positions, cast(ChartRates, velocities * rates[:, None])


def _through_knots(problem: Problem, schedule: Schedule) -> Knots:
    """The cubic Hermite curve through the motion's own knots, and where the rate begins to change or ends to."""
    motion, step = schedule.motion, schedule.step
    even = np.arange(0.0, schedule.duration, step / KNOTS)
    fine = np.linspace(0.0, schedule.duration, 4 * len(even) + 1)
    own = np.maximum.accumulate(schedule.at(fine, step)[0])
    among = np.interp(motion.times - motion.times[0], own, fine)
    times = np.unique(np.concatenate([even, among, [0.0, schedule.duration]]))
    kept = np.r_[True, np.diff(times) > SHORTEST_PIECE]
    kept[-1] = True
    times = times[kept]
    if len(times) > 2 and times[-1] - times[-2] <= SHORTEST_PIECE:
        times = np.delete(times, -2)
    positions, velocities = _sample(schedule, times)
    velocities[[0, -1]] = 0.0
    lower, upper = problem.group.lower, problem.group.upper
    changed = find_leaving(times, positions, velocities, lower, upper)
    if changed.any():
        velocities[:, changed] = bound_slopes(
            times, positions[:, changed], velocities[:, changed], lower[changed], upper[changed]
        )
    return times, positions, velocities


def _through_samples(problem: Problem, schedule: Schedule) -> Knots:
    """The cubic spline through even samples that is twice continuously differentiable, at rest at both ends."""
    count = max(8, math.ceil(KNOTS * schedule.duration / schedule.step))
    times = np.linspace(0.0, schedule.duration, count + 1)
    positions, velocities = fit_smooth_spline(times, _sample(schedule, times)[0])
    lower, upper = problem.group.lower, problem.group.upper
    changed = find_leaving(times, positions, velocities, lower, upper)
    if changed.any():
        positions[:, changed], velocities[:, changed] = clamp_smoothly(
            times, positions[:, changed], velocities[:, changed], lower[changed], upper[changed]
        )
    return times, positions, velocities


def wait_until_begin(motion: Trajectory) -> Trajectory:
    """The motion from time 0 on: until its own begins the robot waits at its start."""
    if motion.times[0] <= 0.0:
        return motion
    still = np.zeros_like(motion.velocities[:1])
    return Trajectory(
        np.concatenate([[0.0], motion.times]),
        cast(ChartPoints, np.concatenate([motion.positions[:1], motion.positions])),
        cast(ChartRates, np.concatenate([still, motion.velocities])),
    )
