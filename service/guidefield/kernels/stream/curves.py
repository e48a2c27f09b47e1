"""Motions of constant jerk in parts, as the judge of streams reads them: values, ranges, and limits held exactly.

A coordinate's motion is a row of phases, each with its beginning, value, velocity, acceleration and jerk; the last one
stands still. Between, everything is a polynomial: its extremes are at ends and at roots in closed form.
"""

from __future__ import annotations

import math

from guidefield.kernels.jit.signatures import Floats, lane_part

BEGIN, VALUE, VELOCITY, ACCELERATION, JERK = range(5)
PHASE = 5
"""Numbers of a phase: its columns."""

EXACT = 1e-9
"""Tolerance for rounding, of a limit or of continuity, as a share of the limit or in [rad or m, s]."""


@lane_part
def phase_at(phases: Floats, count: int, time: float) -> int:
    """Return which phase, of rows (k, `PHASE`), is on at a time [s]."""
    k = 0
    while k + 1 < count and phases[k + 1, BEGIN] <= time:
        k += 1
    return k


@lane_part
def value_at(phases: Floats, count: int, time: float) -> float:
    """The value [rad or m] of a coordinate, phases in rows (k, `PHASE`), at a time [s]."""
    row = phases[phase_at(phases, count, time)]
    s = time - row[BEGIN]
    return float(row[VALUE] + s * (row[VELOCITY] + s * (0.5 * row[ACCELERATION] + s * row[JERK] / 6.0)))


@lane_part
def range_of(phases: Floats, count: int, begin: float, end: float) -> tuple[float, float]:
    """The least and the largest value of a coordinate within a time.

    Args:
        phases: Its phases in rows, shape (k, `PHASE`).
        count: How many there are.
        begin: From when [s].
        end: Until when [s].
    """
    least = largest = value_at(phases, count, begin)
    k = phase_at(phases, count, begin)
    while True:
        row = phases[k]
        until = end if k + 1 == count else min(end, phases[k + 1, BEGIN])
        since = max(begin, row[BEGIN])
        v, a, j = row[VELOCITY], row[ACCELERATION], row[JERK]
        square = a * a - 2.0 * j * v
        for which in range(3):
            s = until - row[BEGIN]
            if which < 2:
                # roots of v + a s + j s^2 / 2, without cancellation
                if square < 0.0:
                    continue
                sum_ = -(a + math.copysign(math.sqrt(square), a))
                if which == 0:
                    if j == 0.0:
                        continue
                    s = sum_ / j
                else:
                    if sum_ == 0.0:
                        continue
                    s = 2.0 * v / sum_
                if not (since - row[BEGIN] < s < until - row[BEGIN]):
                    continue
            value = row[VALUE] + s * (v + s * (0.5 * a + s * j / 6.0))
            least, largest = min(least, value), max(largest, value)
        if k + 1 == count or phases[k + 1, BEGIN] >= end:
            return least, largest
        k += 1


@lane_part
def keeps_limits(  # noqa: PLR0911 - one for each thing that may be wrong
    phases: Floats,
    count: int,
    since: Floats,
    until: float,
    velocity: float,
    acceleration: float,
    jerk: float,
) -> bool:
    """Tell if a coordinate goes on from a state without a jump, keeps its limits, and stands still in the end.

    Args:
        phases: Its phases in rows, shape (k, `PHASE`), times from 0.
        count: How many there are.
        since: Value, velocity and acceleration at 0, shape (3,).
        until: When it is to stand still [s].
        velocity: Its limit [rad/s or m/s].
        acceleration: Its limit [rad/s^2 or m/s^2].
        jerk: Its limit [rad/s^3 or m/s^3].
    """
    more = 1.0 + EXACT
    q, v, a = since[0], since[1], since[2]
    if count < 1 or phases[0, BEGIN] != 0.0:
        return False
    for k in range(count):
        row = phases[k]
        scale = EXACT * (1.0 + abs(q))
        if not (
            abs(row[VALUE] - q) <= scale
            and abs(row[VELOCITY] - v) <= EXACT * (1.0 + velocity)
            and abs(row[ACCELERATION] - a) <= EXACT * (1.0 + acceleration)
        ):
            return False
        j = row[JERK]
        if not (abs(j) <= jerk * more and abs(row[ACCELERATION]) <= acceleration * more):
            return False
        if not abs(row[VELOCITY]) <= velocity * more:
            return False
        if k + 1 == count:
            stands = row[VELOCITY] == 0.0 and row[ACCELERATION] == 0.0 and j == 0.0
            return bool(stands and row[BEGIN] <= until + EXACT)
        s = phases[k + 1, BEGIN] - row[BEGIN]
        if not s >= 0.0:
            return False
        if j != 0.0:
            turn = -row[ACCELERATION] / j
            if 0.0 < turn < s and not abs(row[VELOCITY] + 0.5 * turn * row[ACCELERATION]) <= velocity * more:
                return False
        q = row[VALUE] + s * (row[VELOCITY] + s * (0.5 * row[ACCELERATION] + s * j / 6.0))
        v = row[VELOCITY] + s * (row[ACCELERATION] + 0.5 * s * j)
        a = row[ACCELERATION] + s * j
    return False
