"""A commit of a stream as phases of constant jerk: a piece and its braking, their states, limits and travel.

`stream/commit.py` sends a commit only if `broken_limit` finds none: nothing else in a stream checks limits of joints;
those of speeds in space it checks itself, and `kernels/prove` proves what a commit keeps from obstacles. The judge
trusts nothing of `piece_and_braking` but its columns. So another rule there, of the quickest change of velocity or the
hardest braking, changes how a stream moves, and to what kept journals replay, but breaks no limit; `EXACT` can.
"""

from __future__ import annotations

import math

import numpy as np

from guidefield.kernels.jit.arrays import Blocks, BlocksOut, Floats, Indices, IndicesOut, Row, RowOut, Rows
from guidefield.kernels.jit.decorators import kernel, vector_kernel, vector_part
from guidefield.kernels.prove.kept_distance import LOG_ROWS
from guidefield.kernels.prove.motion_bounds import TRAVEL, bound_body, find_moves
from guidefield.kernels.prove.placement import find_twists, place_at
from guidefield.kernels.prove.samples import new_search
from guidefield.kernels.prove.tables import BezierCurve, MovingRobot

BEGIN, VALUE, VELOCITY, ACCELERATION, JERK = range(5)  # columns of a phase: its begin [s], and the state there
PHASE = 5  # their number; `stream/commit.py` has it as 5, and files of journals have them
EXACT = 1e-9  # a commit may break a limit of rates or jump by this, for rounding: share of the limit, or [rad or m, s]

MOST_PHASES = 9  # of a coordinate: up to four of a piece, three of braking, one of standing; nothing checks it
HALVINGS = 40  # bisections for the velocity whose piece and braking end at a given value
SOFTENINGS = 12  # bisections for the share of the limits with which a coordinate takes as long as the slowest one
_REACHED = 1e-10  # an end this close to the given value has reached it [rad or m]


@vector_part
def phase_at(phases: Floats, count: int, time: float) -> int:
    """Return which phase, of rows (k, `PHASE`), is on at a time [s]."""
    k = 0
    while k + 1 < count and phases[k + 1, BEGIN] <= time:
        k += 1
    return k


@vector_part
def value_at(phases: Floats, count: int, time: float) -> float:
    """The value [rad or m] of a coordinate, phases in rows (k, `PHASE`), at a time [s]."""
    row = phases[phase_at(phases, count, time)]
    s = time - row[BEGIN]
    return float(row[VALUE] + s * (row[VELOCITY] + s * (0.5 * row[ACCELERATION] + s * row[JERK] / 6.0)))


@vector_kernel
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


@vector_part
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


@vector_part
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


@vector_kernel
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
    search, bodies, most = new_search(moving, np.zeros(LOG_ROWS)), moving.robot.parent_joints.shape[0], 0.0
    as_planned = MovingRobot(moving.robot, moving.obstacles, moving.movers, moving.pairs, exact)
    travels, within, off = np.zeros(bodies), np.zeros(bodies), np.zeros(bodies)
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
                travels[body] += 2.0 * travel
                continue
            if part == 1:
                off[body] = travel - within[body]
            most = max(most, travels[body] + off[body] + travel - within[body])
    return most


@vector_part
def _change(v: float, a: float, u: float, most: float, jerk: float) -> tuple[float, float, float, float]:
    """The quickest change of velocity to u: signed jerk of the first part, and how long the three parts last [s]."""
    side = 1.0 if u >= v + 0.5 * a * abs(a) / jerk else -1.0
    rise, b = side * (u - v), side * a
    peak = math.sqrt(max(0.0, jerk * rise + 0.5 * b * b))
    hold = 0.0
    if peak > most:
        peak = most
        hold = max(0.0, (rise - (peak * peak - 0.5 * b * b) / jerk) / most)
    peak = max(peak, b)  # but for rounding it is: the last part ends without acceleration
    return side * jerk, (peak - b) / jerk, hold, peak / jerk


@vector_part
def _along(q: float, v: float, a: float, j: float, s: float) -> tuple[float, float, float]:
    """Value, velocity and acceleration a time s [s] later, at constant jerk j."""
    return q + s * (v + s * (0.5 * a + s * j / 6.0)), v + s * (a + 0.5 * s * j), a + s * j


@vector_part
def _end_of(q: float, v: float, a: float, u: float, piece: float, most: float, jerk: float) -> float:
    """Value at which a coordinate stands after a piece [s] towards a velocity u and the hardest braking [rad or m]."""
    j, first, hold, last = _change(v, a, u, most, jerk)
    s = min(piece, first)
    q, v, a = _along(q, v, a, j, s)
    left = piece - s
    s = min(left, hold)
    q, v, a = _along(q, v, a, 0.0, s)
    left -= s
    s = min(left, last)
    q, v, a = _along(q, v, a, -j, s)
    left -= s
    if left > 0.0:
        q, v, a = _along(q, v, 0.0, 0.0, left)
    j, first, hold, last = _change(v, a, 0.0, most, jerk)
    q, v, a = _along(q, v, a, j, first)
    q, v, a = _along(q, v, a, 0.0, hold)
    q, v, a = _along(q, v, a, -j, last)
    return q


@vector_part
def _ending_at(q: float, v: float, a: float, u: float, goal: float, piece: float, most: float, jerk: float) -> float:
    """The velocity from 0 to u whose piece and braking end at a goal, or u if even that doesn't lead beyond it."""
    fast = _end_of(q, v, a, u, piece, most, jerk) - goal
    if (u >= 0.0 and fast <= 0.0) or (u < 0.0 and fast >= 0.0):
        return u
    # the goal is behind: back as fast as need be, if going slower alone doesn't do
    low, high = (-abs(u), u) if u >= 0.0 else (u, abs(u))
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        beyond = _end_of(q, v, a, middle, piece, most, jerk) - goal
        if abs(beyond) <= _REACHED:
            return middle
        if beyond > 0.0:
            high = middle
        else:
            low = middle
    return 0.5 * (low + high)


@vector_part
def _duration(v: float, a: float, u: float, most: float, jerk: float) -> float:
    """Return how long the quickest change of velocity lasts [s]; see `_change`."""
    _, first, hold, last = _change(v, a, u, most, jerk)
    return first + hold + last


@vector_part
def _find_softest(v: float, a: float, u: float, most: float, jerk: float, time: float) -> float:
    """The least share of acceleration and jerk that changes a velocity within a time [s], and never beyond v and u."""
    low, high = 0.0, 1.0
    for _ in range(SOFTENINGS):
        share = 0.5 * (low + high)
        beyond = v + 0.5 * a * abs(a) / (share * jerk)
        if min(v, u) <= beyond <= max(v, u) and _duration(v, a, u, max(abs(a), share * most), share * jerk) <= time:
            high = share
        else:
            low = share
    return high


@vector_part
def _soften(
    state: Floats, u: float, lasts: float, slowest: float, limits: Floats, lower: float, upper: float
) -> tuple[float, float]:
    """Limits of acceleration and jerk with which a change of velocity lasts as long as the slowest one [s].

    They stay unchanged where the end wouldn't keep `lower` and `upper`; `lasts` is infinite until u is reached.
    """
    q, v, a = state[0], state[1], state[2]
    share = _find_softest(v, a, u, limits[1], limits[2], slowest)
    soft, slow = max(abs(a), share * limits[1]), share * limits[2]
    end = _end_of(q, v, a, u, lasts if math.isfinite(lasts) else 0.0, soft, slow)
    return (soft, slow) if lower <= end <= upper else (limits[1], limits[2])


@vector_part
def _write_change(
    state: Floats, u: float, lasts: float, most: float, jerk: float, phases: Floats, count: int, begin: float
) -> tuple[int, float]:
    """Write the phases of a change of velocity and the state at its end; their count then, and when the last ends [s].

    `lasts` is how long it goes on towards u [s], infinite until u is reached; `count` phases are there, which end at
    `begin`.
    """
    q, v, a = state[0], state[1], state[2]
    j, first, hold, last = _change(v, a, u, most, jerk)
    left = lasts
    for which in range(4):
        length, rate = first, j
        if which == 1:
            length, rate = hold, 0.0
        elif which == 2:
            length, rate = last, -j
        elif which == 3:
            length, rate = left if math.isfinite(lasts) else 0.0, 0.0
            if length > 0.0:
                a = 0.0  # but for rounding it is
        length = min(length, left)
        if length <= 0.0:
            continue
        row = phases[count]
        row[0], row[1], row[2], row[3], row[4] = begin, q, v, a, rate
        q, v, a = _along(q, v, a, rate, length)
        begin, left, count = begin + length, left - length, count + 1
    state[0], state[1], state[2] = q, v, a
    return count, begin


@kernel
def piece_and_braking(
    state: Rows,
    velocities: Row,
    goals: Row,
    lower: Row,
    upper: Row,
    piece: float,
    limits: Rows,
    phases: BlocksOut,
    counts: IndicesOut,
    ends: RowOut,
) -> float:
    """Write the motion of a piece towards velocities (nv,), and of hard braking after it.

    Return when the last one stands [s]. `state` (nv, 3) are value, velocity and acceleration, `goals` (nv,) where a
    coordinate isn't led beyond, infinite: none; `lower` and `upper` (nv,) bound values, `limits` (nv, 3) velocity,
    acceleration and jerk; the piece lasts `piece` [s]. Writes phases (nv, `MOST_PHASES`, 5): begin from that of the
    piece [s], value, velocity, acceleration, jerk; their counts (nv,), and where coordinates stand in the end (nv,).
    """
    count, stops = state.shape[0], 0.0
    wanted, begun, now = np.empty(count), np.zeros(count), state.copy()
    for k in range(count):
        q, v, a = state[k, 0], state[k, 1], state[k, 2]
        most, jerk = limits[k, 1], limits[k, 2]
        u = min(max(velocities[k], -limits[k, 0]), limits[k, 0])
        if math.isfinite(goals[k]):
            u = _ending_at(q, v, a, u, goals[k], piece, most, jerk)
        edge = upper[k] if u >= 0.0 else lower[k]
        if math.isfinite(edge):
            u = _ending_at(q, v, a, u, edge, piece, most, jerk)
        wanted[k], counts[k] = u, 0
    for part in range(2):
        # a coordinate that changes less takes as long as the slowest, so that all go straight on together; not on its
        # last approach, to a finite goal
        slowest = 0.0
        for k in range(count):
            u = wanted[k] if part == 0 else 0.0
            slowest = max(slowest, _duration(now[k, 1], now[k, 2], u, limits[k, 1], limits[k, 2]))
        for k in range(count):
            u, lasts = (wanted[k], piece) if part == 0 else (0.0, math.inf)
            most, jerk = limits[k, 1], limits[k, 2]
            if not math.isfinite(goals[k]):
                most, jerk = _soften(now[k], u, lasts, slowest, limits[k], lower[k], upper[k])
            counts[k], begun[k] = _write_change(now[k], u, lasts, most, jerk, phases[k], counts[k], begun[k])
    for k in range(count):
        row = phases[k, counts[k]]
        row[0], row[1], row[2], row[3], row[4] = begun[k], now[k, 0], 0.0, 0.0, 0.0
        counts[k], ends[k] = counts[k] + 1, now[k, 0]
        stops = max(stops, begun[k])
    return stops
