"""Limits that a commit keeps, and a bound on the robot's travel; `kernels/prove` proves what it keeps from obstacles.

A commit is sent only if `broken_limit` finds none: nothing else in a stream checks limits of joints; those of speeds in
space are checked by `stream/commit.py`. Its phases are those of `way`, of constant jerk, in the same columns.
"""

from __future__ import annotations

import math

import numpy as np

from guidefield.kernels.jit.arrays import Blocks, BlocksOut, Floats, Indices, Row, Rows
from guidefield.kernels.jit.decorators import kernel, lane_kernel, lane_part
from guidefield.kernels.prove.kept_distance import LOG_ROWS
from guidefield.kernels.prove.motion_bounds import TRAVEL, bound_body, find_moves
from guidefield.kernels.prove.placement import find_twists, place_at
from guidefield.kernels.prove.samples import new_search
from guidefield.kernels.prove.tables import BezierCurve, MovingRobot

BEGIN, VALUE, VELOCITY, ACCELERATION, JERK = range(5)  # columns of a phase: its begin [s], and the state there
PHASE = 5  # their number
EXACT = 1e-9  # a commit may break a limit of rates or jump by this, for rounding: share of the limit, or [rad or m, s]


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


@lane_kernel
def find_states(phases: Blocks, counts: Indices, times: Row, states_out: BlocksOut) -> None:
    """Write value, velocity, acceleration and jerk of a motion at times (t,) from its beginning [s], shape (t, nv, 4).

    `phases` (nv, k, `PHASE`) and `counts` (nv,) are the motion.
    """
    for i in range(times.shape[0]):
        for k in range(counts.shape[0]):
            row, state = phases[k, phase_at(phases[k], counts[k], times[i])], states_out[i, k]
            s, v, a, j = times[i] - row[BEGIN], row[VELOCITY], row[ACCELERATION], row[JERK]
            state[0], state[1] = row[VALUE] + s * (v + s * (0.5 * a + s * j / 6.0)), v + s * (a + 0.5 * s * j)
            state[2], state[3] = a + s * j, j


@lane_part
def range_of(phases: Floats, count: int, begin: float, end: float) -> tuple[float, float]:
    """Return the least and the largest value of a coordinate, phases in rows (k, `PHASE`), between two times [s]."""
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
    phases: Floats, count: int, since: Floats, until: float, velocity: float, acceleration: float, jerk: float
) -> bool:
    """Tell if a coordinate goes on from a state (3,) without a jump, keeps its limits, and stands still at `until` [s].

    Its `count` phases are rows (k, `PHASE`), with times from 0; the limits are those of velocity, acceleration and
    jerk.
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


@lane_kernel
def broken_limit(phases: Blocks, counts: Indices, start: Rows, limits: Rows, until: float) -> int:
    """Return the first coordinate of a motion that breaks a limit, jumps, or doesn't stand in the end; -1: none does.

    `phases` (nv, k, `PHASE`) and `counts` (nv,) are the motion with times from its beginning, `start` (nv, 3) value,
    velocity and acceleration at first, `limits` (nv, 5) least and largest value, velocity, acceleration and jerk; it
    stands still from `until` on [s].
    """
    for j in range(counts.shape[0]):
        least, largest = range_of(phases[j], counts[j], 0.0, until)
        kept = keeps_limits(phases[j], counts[j], start[j], until, limits[j, 2], limits[j, 3], limits[j, 4])
        if not (kept and least >= limits[j, 0] and largest <= limits[j, 1]):
            return j
    return -1


@kernel
def bound_travel(moving: MovingRobot, exact: BezierCurve, since: float, until: float, parts: int) -> float:
    """Bound how far any point of the robot comes from where it is at first, between two parameters [m].

    The robot is off its motion by its tolerances, at first and later; `exact` is the motion without these. It is added
    up in `parts` parts.
    """
    search, bodies, most = new_search(moving, np.zeros(LOG_ROWS)), moving.robot.carriers.shape[0], 0.0
    as_planned = MovingRobot(moving.robot, moving.obstacles, moving.movers, moving.pairs, exact)
    ways, within, off = np.zeros(bodies), np.zeros(bodies), np.zeros(bodies)
    for part in range(2 * parts):
        a, b = since + (until - since) * (part // 2) / parts, since + (until - since) * (part // 2 + 1) / parts
        which = as_planned if part % 2 == 0 else moving
        place_at(which, 0.5 * (a + b), search.place, search.scratch)
        share = find_moves(which, a, b, search.place, search.scratch, search.bounds)
        find_twists(which, search.place, search.scratch)
        for body in range(bodies):
            row = bound_body(moving.robot, body, part + 1, share, search.place, search.bounds)
            travel = search.bounds.known[row, TRAVEL]
            if part % 2 == 0:
                # from one end of the part to any place in it, both within reach of the middle
                within[body] = travel
                ways[body] += 2.0 * travel
                continue
            if part == 1:
                off[body] = travel - within[body]
            most = max(most, ways[body] + off[body] + travel - within[body])
    return most
