"""Pieces of a stream: the quickest change of velocity of each coordinate within its jerk, and the hardest braking.

`stream/commit.py` calls it, and has `judge` check what it wrote: phases of constant jerk, in that file's columns.
So another rule here changes how a stream moves, and can't break a limit: what `judge` refuses isn't sent.
"""

from __future__ import annotations

import math

import numpy as np

from guidefield.kernels.jit.arrays import BlocksOut, Floats, IndicesOut, Row, RowOut, Rows
from guidefield.kernels.jit.decorators import kernel, lane_part

MOST_PHASES = 9  # of a coordinate: up to four of a piece, three of braking, one of standing; nothing checks it
HALVINGS = 40  # bisections for the velocity whose piece and braking end at a given value
SOFTENINGS = 12  # bisections for the share of the limits with which a coordinate takes as long as the slowest one
_REACHED = 1e-10  # an end this close to the given value has reached it [rad or m]


@lane_part
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


@lane_part
def _along(q: float, v: float, a: float, j: float, s: float) -> tuple[float, float, float]:
    """Value, velocity and acceleration a time s [s] later, at constant jerk j."""
    return q + s * (v + s * (0.5 * a + s * j / 6.0)), v + s * (a + 0.5 * s * j), a + s * j


@lane_part
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


@lane_part
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


@lane_part
def _lasts(v: float, a: float, u: float, most: float, jerk: float) -> float:
    """Return how long the quickest change of velocity lasts [s]; see `_change`."""
    _, first, hold, last = _change(v, a, u, most, jerk)
    return first + hold + last


@lane_part
def _softest(v: float, a: float, u: float, most: float, jerk: float, time: float) -> float:
    """The least share of acceleration and jerk that changes a velocity within a time [s], and never beyond v and u."""
    low, high = 0.0, 1.0
    for _ in range(SOFTENINGS):
        share = 0.5 * (low + high)
        beyond = v + 0.5 * a * abs(a) / (share * jerk)
        if min(v, u) <= beyond <= max(v, u) and _lasts(v, a, u, max(abs(a), share * most), share * jerk) <= time:
            high = share
        else:
            low = share
    return high


@lane_part
def _softened(
    state: Floats, u: float, lasts: float, slowest: float, limits: Floats, lower: float, upper: float
) -> tuple[float, float]:
    """Limits of acceleration and jerk with which a change of velocity lasts as long as the slowest one [s].

    They stay unchanged where the end wouldn't keep `lower` and `upper`; `lasts` is infinite until u is reached.
    """
    q, v, a = state[0], state[1], state[2]
    share = _softest(v, a, u, limits[1], limits[2], slowest)
    soft, slow = max(abs(a), share * limits[1]), share * limits[2]
    end = _end_of(q, v, a, u, lasts if math.isfinite(lasts) else 0.0, soft, slow)
    return (soft, slow) if lower <= end <= upper else (limits[1], limits[2])


@lane_part
def _write(
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
            slowest = max(slowest, _lasts(now[k, 1], now[k, 2], u, limits[k, 1], limits[k, 2]))
        for k in range(count):
            u, lasts = (wanted[k], piece) if part == 0 else (0.0, math.inf)
            most, jerk = limits[k, 1], limits[k, 2]
            if not math.isfinite(goals[k]):
                most, jerk = _softened(now[k], u, lasts, slowest, limits[k], lower[k], upper[k])
            counts[k], begun[k] = _write(now[k], u, lasts, most, jerk, phases[k], counts[k], begun[k])
    for k in range(count):
        row = phases[k, counts[k]]
        row[0], row[1], row[2], row[3], row[4] = begun[k], now[k, 0], 0.0, 0.0, 0.0
        counts[k], ends[k] = counts[k] + 1, now[k, 0]
        stops = max(stops, begun[k])
    return stops
