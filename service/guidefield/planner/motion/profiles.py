"""The motion from any velocity to rest by constant jerks, each joint by itself, and reversed; for in_motion.py."""

from __future__ import annotations

import math
from typing import cast

import numpy as np

from guidefield.planner.motion.trajectory import Trajectory
from guidefield.robot.model.spaces import ChartPoint, ChartPoints, ChartRate, ChartRates

RAMP = 0.02  # where there is no limit of jerk, accelerations rise to their limit in this time [s]
APART = 1e-9  # times that are closer than this are one [s]
ROUNDING = 1e-5  # share of a jerk limit that is left for the rounding of jerks in short pieces
CLOSE = 5e-4  # in pieces shorter than this, rounding of jerks is more than that, at some 100 rad/s³ [s]
SLOWER = 0.998  # a joint's jerk is lowered by this factor at a time
TRIES = 60  # times that it is lowered at most


def choose_jerks(acceleration_limits: ChartRate, jerk_limits: ChartRate | None, rises: ChartRate) -> ChartRate:
    """The jerks with which joints stop, shape (nv,), all finite [rad/s³ or m/s³].

    `rises` (nv,) are the least jerks that keep the velocities' limits.
    """
    own = np.maximum(acceleration_limits / RAMP, 1.01 * rises)
    if jerk_limits is None:
        return own
    kept = np.minimum(jerk_limits, np.maximum(rises, (1.0 - ROUNDING) * jerk_limits))
    return np.where(np.isfinite(jerk_limits), kept, own)


def separate_jerks(
    velocity: ChartRate, acceleration: ChartRate, acceleration_limits: ChartRate, jerks: ChartRate, rises: ChartRate
) -> ChartRate:
    """Jerks (nv,), some of them a little lower, with which no two knots of `stop_motion` are close but not the same.

    In pieces that short the jerk of a curve is rounding. Where no such jerk is found a joint keeps its own; none is
    less than it rises at least.
    """
    chosen, knots = jerks.copy(), np.zeros(1)
    for j, (v, a, limit, least) in enumerate(zip(velocity, acceleration, acceleration_limits, rises, strict=True)):
        jerk = float(jerks[j])
        for _ in range(TRIES):
            both = _add_jerk_times(knots, float(v), float(a), float(limit), jerk)
            if (np.diff(both) >= CLOSE).all():
                chosen[j] = jerk
                break
            jerk *= SLOWER
            if jerk < least:
                break
        knots = _add_jerk_times(knots, float(v), float(a), float(limit), float(chosen[j]))
    return chosen


def _add_jerk_times(knots: np.ndarray, velocity: float, acceleration: float, limit: float, jerk: float) -> np.ndarray:
    """Times (n,) with those at which a joint's jerk changes, in order, each once."""
    spans = [span for span, _ in _phases(velocity, acceleration, limit, jerk)]
    times = np.unique(np.concatenate([knots, np.cumsum(spans)]))
    apart: np.ndarray = times[np.concatenate([[True], np.diff(times) > APART])]
    return apart


def stop_motion(
    position: ChartPoint, velocity: ChartRate, acceleration: ChartRate, acceleration_limits: ChartRate, jerks: ChartRate
) -> Trajectory:
    """The motion to rest, without acceleration, each joint by itself, with positive and finite jerks (nv,).

    Its knots are where any joint's jerk changes, so that it is exact; a single knot if it is at rest.
    """
    phases = [_phases(*map(float, one)) for one in zip(velocity, acceleration, acceleration_limits, jerks, strict=True)]
    bounds = np.array([np.cumsum([span for span, _ in one]) for one in phases])
    times = np.unique(np.concatenate([[0.0], bounds.ravel()]))
    times = times[np.concatenate([[True], np.diff(times) > APART])]
    begins = zip(position, velocity, acceleration, phases, strict=True)
    states = [_states(times, float(x), float(v), float(a), spans) for x, v, a, spans in begins]
    positions = cast(ChartPoints, np.column_stack([x for x, _ in states]))
    velocities = cast(ChartRates, np.column_stack([v for _, v in states]))
    positions[0], velocities[0] = position, velocity
    velocities[-1] = 0.0
    return Trajectory(times, positions, velocities)


def reverse_motion(motion: Trajectory) -> Trajectory:
    """The motion from its end to its start."""
    times = motion.times[-1] - motion.times[::-1]
    return Trajectory(times, motion.positions[::-1].copy(), -motion.velocities[::-1] + 0.0)


def _phases(velocity: float, acceleration: float, limit: float, jerk: float) -> tuple[tuple[float, float], ...]:
    rest = velocity + acceleration * abs(acceleration) / (2.0 * jerk)
    sign = -math.copysign(1.0, rest)
    v, a = sign * velocity, sign * acceleration
    peak = math.sqrt(max(0.5 * a * a - jerk * v, max(a, 0.0) ** 2))
    hold = 0.0
    if peak > limit:
        peak = limit
        hold = max((-v - (2.0 * peak * peak - a * a) / (2.0 * jerk)) / peak, 0.0)
    return (max((peak - a) / jerk, 0.0), sign * jerk), (hold, 0.0), (peak / jerk, -sign * jerk)


def _states(
    times: np.ndarray, x: float, v: float, a: float, phases: tuple[tuple[float, float], ...]
) -> tuple[np.ndarray, np.ndarray]:
    positions, velocities = np.empty_like(times), np.empty_like(times)
    begin, done = 0.0, times < 0.0
    for span, jerk in (*phases, (math.inf, 0.0)):
        here = ~done & (times <= begin + span)
        t = times[here] - begin
        positions[here] = x + t * (v + t * (0.5 * a + t * jerk / 6.0))
        velocities[here] = v + t * (a + 0.5 * t * jerk)
        done |= here
        if span < math.inf:
            x += span * (v + span * (0.5 * a + span * jerk / 6.0))
            v += span * (a + 0.5 * span * jerk)
            a += span * jerk
            begin += span
    return positions, velocities
