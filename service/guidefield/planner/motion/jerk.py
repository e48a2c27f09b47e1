"""Timing with jerk limits: the time-optimal way along a curve, its accelerations made to change gradually.

The curve's parameter as a function of time, which is optimal under velocity and acceleration limits, is averaged over a
window of time. That turns its steps of acceleration into ramps and leaves the curve as it is. The motion is *defined*
as the spline in time through its samples that is twice continuously differentiable and begins and ends at rest, without
acceleration; within a piece its jerk is constant, so that its extrema are known exactly, and the time scale is the
shortest that exceeds no limit. Several windows and accelerations are tried. It is no optimal solution of third order.
"""

from __future__ import annotations

import math
from itertools import product
from typing import cast

import numpy as np

from guidefield.planner.motion.limit_load import limit_load
from guidefield.planner.motion.settings import JERK
from guidefield.planner.motion.spline import CubicSpline
from guidefield.planner.motion.timing import fastest, parameterize
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.motion.within_limits import leaving, smoothly_within
from guidefield.robot.model.spaces import ChartPoints, ChartRate, ChartRates


def parameterize_gently(
    spline: CubicSpline,
    velocity_limits: ChartRate,
    acceleration_limits: ChartRate,
    jerk_limits: ChartRate,
    finer: int = 1,
) -> Trajectory:
    """A fast motion along a spline, from rest to rest, that exceeds no limit at any time.

    Its accelerations are continuous, and zero at both ends.

    Args:
        spline: The curve, in chart coordinates [rad or m].
        velocity_limits: Shape (nv,), finite and positive [rad/s or m/s].
        acceleration_limits: Shape (nv,), finite and positive [rad/s² or m/s²].
        jerk_limits: Shape (nv,), positive, infinite where there is none [rad/s³ or m/s³].
        finer: How many times as many pieces it has as a smooth curve needs: it keeps closer to one with corners.

    Returns:
        The motion; a single knot if the spline is a point.

    Raises:
        ValueError: if there isn't one positive limit for each coordinate.
    """
    jerk_limits = np.asarray(jerk_limits, float)
    if jerk_limits.shape != velocity_limits.shape or not (jerk_limits > 0.0).all():
        raise ValueError(f"expected {len(velocity_limits)} positive jerk limits, got {jerk_limits}")
    if spline.is_point:
        return parameterize(spline, velocity_limits, acceleration_limits)
    best = None
    ways = [fastest(spline, velocity_limits, share * acceleration_limits) for share in JERK.accelerations]
    for (s, times, rates), window in product(ways, JERK.windows):
        motion = _averaged(spline, s, times, rates, window * times[-1], finer)
        load = limit_load(*motion, velocity_limits, acceleration_limits, jerk_limits)
        if best is None or load * motion[0][-1] < best[0]:
            best = load * motion[0][-1], load, motion
    assert best is not None, "something was tried"
    _, load, (times, positions, velocities) = best
    load *= 1.0 + 1e-9  # rounding
    return Trajectory(times * load, positions, velocities / load + 0.0, load)


def _averaged(
    spline: CubicSpline, s: np.ndarray, times: np.ndarray, rates: np.ndarray, window: float, finer: int
) -> tuple[np.ndarray, ChartPoints, ChartRates]:
    """Knots of the motion whose parameter is the average of s over a window: times, positions, velocities."""
    duration = float(times[-1]) + window
    count = finer * int(np.clip(math.ceil(JERK.pieces * duration / window), 8, JERK.most_pieces))
    fine = np.linspace(0.0, duration, JERK.samples * count + 1)
    before, now = (_integral(s, times, rates, moment) for moment in (fine - window, fine))
    share = (now - before)[:: JERK.samples] / window
    knots = fine[:: JERK.samples].copy()
    positions = spline.evaluate(np.clip(share, 0.0, spline.knots[-1]))[0]
    positions[0], positions[-1] = spline.waypoints[0], spline.waypoints[-1]
    positions, velocities = smooth(knots, positions)
    changed = leaving(knots, positions, velocities, spline.lower, spline.upper)
    if changed.any():
        limits = spline.lower[changed], spline.upper[changed]
        kept = smoothly_within(knots, positions[:, changed], velocities[:, changed], *limits)
        positions[:, changed], velocities[:, changed] = kept
    return knots, positions, velocities


def _integral(s: np.ndarray, times: np.ndarray, rates: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Integral from 0 to given times of s, which is cubic between its knots, and constant before and after them."""
    h = np.diff(times)
    a, b, da, db = s[:-1], s[1:], rates[:-1], rates[1:]
    whole = np.r_[0.0, np.cumsum(h * (a + b) / 2.0 + h**2 * (da - db) / 12.0)]
    inside = np.clip(at, 0.0, times[-1])
    piece = np.clip(np.searchsorted(times, inside, side="right") - 1, 0, len(h) - 1)
    x, width = inside - times[piece], h[piece]
    slope = (b - a)[piece] / width
    second = (3.0 * slope - 2.0 * da[piece] - db[piece]) / width
    third = (da[piece] + db[piece] - 2.0 * slope) / width**2
    within = x * (a[piece] + x * (da[piece] / 2.0 + x * (second / 3.0 + x * third / 4.0)))
    integral: np.ndarray = whole[piece] + within + np.maximum(at - times[-1], 0.0) * s[-1]
    return integral


def smooth(times: np.ndarray, positions: ChartPoints) -> tuple[ChartPoints, ChartRates]:
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
