"""The logarithmic barriers of a uniform cubic B-spline in time against the limits of its joints and of its duration.

With control points P, pieces of length h and u = log h, the ratios

    r = ΔP / (V h),  Δ²P / (A h²),  Δ³P / (J h³),  (2 P - lower - upper) / (upper - lower)

are between -1 and 1 exactly where accelerations and jerks keep their limits A and J, and only where velocities keep V
and positions their range: of these two they are bounds, as a spline lies in the hull of its control points (de Boor, A
Practical Guide to Splines, 2001, chapter IX). The barrier is the sum of -log(1 - r²).

The first three and the last three control points are the ends'. Velocities and accelerations are given there: ratios of
these points alone are left out, so that a motion may begin at a limit. The velocity next to an end may reach its limit:
it is one of the hull about the first piece, the one before the end is not.

A ratio of order k depends on u by dr/du = -k r. The Hessian is Gauss and Newton's in (P, u), with k² r φ'(r) on the
diagonal of u besides: positive definite.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from guidefield.kernels.jit.arrays import MATRIX, SCALAR, Floats, Row, numba_type
from guidefield.kernels.jit.decorators import compiled, uncounted


class MotionLimits(NamedTuple):
    """Limits of every coordinate, each of shape (nv,); infinite where there is none."""

    velocity: Row  # positive [rad/s, rad/s², rad/s³; or with m]
    acceleration: Row
    jerk: Row
    lower: Row  # range of positions; one that is a single value does not count here [rad or m]
    upper: Row
    sizes: Row  # how many times as far as at size 1 a coordinate goes: 1 for angles


LIMITS = numba_type(MotionLimits)

REACHED = 1.0 + 1e-9  # share of a limit up to which velocities next to an end may go: rounding, docs allow a millionth


@uncounted
def _curve(ratio: float) -> tuple[float, float, float]:
    """-log(1 - r²), its first and second derivative by r."""
    room = 1.0 - ratio * ratio
    return -math.log(room), 2.0 * ratio / room, 2.0 * (1.0 + ratio * ratio) / (room * room)


@compiled(SCALAR(MATRIX, SCALAR, LIMITS))
def limit_barrier(points: Floats, step: float, limits: MotionLimits) -> float:
    """The barrier's value; infinite where a limit is reached.

    Args:
        points: Control points, shape (n, nv) [rad or m].
        step: h [s].
        limits: What is kept.
    """
    n, nv = points.shape
    total = 0.0
    for j in range(nv):
        v = 1.0 / (limits.velocity[j] * step)
        a = 1.0 / (limits.acceleration[j] * step * step)
        e = 1.0 / (limits.jerk[j] * step * step * step)
        low, high = limits.lower[j], limits.upper[j]
        bounded = 0.0 < high - low < math.inf
        room = 1.0
        for i in range(n - 1):
            first = points[i + 1, j] - points[i, j]
            r1, r2, r3, r0 = first * v, 0.0, 0.0, 0.0
            if i > 0:
                r2 = (first - (points[i, j] - points[i - 1, j])) * a
            if i < 2 or i > n - 4:
                if (i == 1 or i == n - 3) and abs(r1) > REACHED:
                    return math.inf
                r1 = 0.0
            if i == 1 or i == n - 2:
                r2 = 0.0
            if i > 1:
                r3 = (first - 2.0 * (points[i, j] - points[i - 1, j]) + (points[i - 1, j] - points[i - 2, j])) * e
            if bounded and 3 <= i < n - 3:
                r0 = (2.0 * points[i, j] - low - high) / (high - low)
            if max(abs(r1), abs(r2), abs(r3), abs(r0)) >= 1.0:
                return math.inf
            room *= (1.0 - r1 * r1) * (1.0 - r2 * r2) * (1.0 - r3 * r3) * (1.0 - r0 * r0)
            if room < 1e-200:
                total -= math.log(room)
                room = 1.0
        total -= math.log(room)
    return total


@uncounted
def add_limit_barrier(
    points: Floats,
    step: float,
    limits: MotionLimits,
    weight: float,
    gradient_out: Floats,
    blocks_out: Floats,
    border_out: Floats,
) -> tuple[float, float, float]:
    """Add the weighted barrier to derivatives by all control points.

    Args:
        points: Control points, shape (n, nv), strictly within limits [rad or m].
        step: h [s].
        limits: What is kept.
        weight: Factor of the barrier.
        gradient_out: By the control points, shape (n, nv).
        blocks_out: Hessian: [i, p, q] couples coordinate p of point i with q % nv of point i - 3 + q // nv; shape
            (n, nv, 4 nv).
        border_out: Hessian by control points and u, shape (n, nv).

    Returns:
        Its value, first and second derivative by u.
    """
    n, nv = points.shape
    total = by_u = by_uu = 0.0
    for j in range(nv):
        for order in range(1, 4):
            limit = limits.velocity[j] if order == 1 else (limits.acceleration[j] if order == 2 else limits.jerk[j])
            if limit == math.inf:
                continue
            scale = 1.0 / (limit * step**order)
            c0, c1, c2, c3 = -scale, scale, 0.0, 0.0
            if order == 2:
                c0, c1, c2 = scale, -2.0 * scale, scale
            elif order == 3:
                c0, c1, c2, c3 = -scale, 3.0 * scale, -3.0 * scale, scale
            coefficients = (c0, c1, c2, c3)
            for i in range(3 - order, n - 3):
                ratio = 0.0
                for b in range(order + 1):
                    ratio += coefficients[b] * points[i + b, j]
                value, slope, curvature = _curve(ratio)
                total += value
                slope, curvature = weight * slope, weight * curvature
                by_u -= order * slope * ratio
                by_uu += order * order * ratio * (curvature * ratio + slope)
                for b in range(order + 1):
                    gradient_out[i + b, j] += slope * coefficients[b]
                    border_out[i + b, j] -= order * ratio * curvature * coefficients[b]
                    for c in range(b + 1):
                        blocks_out[i + b, j, (3 - b + c) * nv + j] += curvature * coefficients[b] * coefficients[c]
        low, high = limits.lower[j], limits.upper[j]
        if 0.0 < high - low < math.inf:
            scale = 2.0 / (high - low)
            for i in range(3, n - 3):
                value, slope, curvature = _curve((points[i, j] - low) * scale - 1.0)
                total += value
                gradient_out[i, j] += weight * slope * scale
                blocks_out[i, j, 3 * nv + j] += weight * curvature * scale * scale
    return weight * total, by_u, by_uu


class TimeLimits(NamedTuple):
    """Limits of a motion's times of departure and arrival."""

    departs: int  # how many departures there are to choose from: 1, or 0 where it is given
    latest: float  # it departs before [s]
    earliest: float  # it arrives after [s]
    unit: float  # t [s]


TIMES = numba_type(TimeLimits)


@uncounted
def time_barrier(times: TimeLimits, begin: float, duration: float) -> float:
    """The barrier of a departure and a duration [s]; infinite where a limit is reached."""
    total, over = 0.0, 1.0 / times.unit
    if times.departs > 0:
        if begin <= 0.0 or begin >= times.latest:
            return math.inf
        total -= math.log(begin * over)
        if times.latest < math.inf:
            total -= math.log((times.latest - begin) * over)
    if times.earliest > -math.inf:
        if begin + duration <= times.earliest:
            return math.inf
        total -= math.log((begin + duration - times.earliest) * over)
    return total


@uncounted
def add_time_barrier(
    times: TimeLimits, begin: float, duration: float, weight: float, by_times_out: Floats, corner_out: Floats
) -> float:
    """Add the weighted barrier's derivatives to those by (u, t0), shapes (2,) and (2, 2); its weighted value."""
    if times.departs > 0:
        by_times_out[1] -= weight / begin
        corner_out[1, 1] += weight / (begin * begin)
        left = times.latest - begin
        by_times_out[1] += weight / left
        corner_out[1, 1] += weight / (left * left)
    if times.earliest > -math.inf:
        over = 1.0 / (begin + duration - times.earliest)
        by_u = duration * over
        by_times_out[0] -= weight * by_u
        by_times_out[1] -= weight * over
        corner_out[0, 0] += weight * by_u * by_u
        corner_out[0, 1] += weight * by_u * over
        corner_out[1, 0] += weight * by_u * over
        corner_out[1, 1] += weight * over * over
    return weight * time_barrier(times, begin, duration)
