"""Pieces of constant jerk, and the hardest braking after them: quickest changes of velocity within exact limits.

From a velocity v and an acceleration a, the quickest way to a velocity u without acceleration is jerk, none, and jerk
the other way, in the direction of  u - v - a |a| / (2 J).  A piece is the beginning of such a way; the way to 0 from
where it ends is the hardest braking. Both keep velocity, acceleration and jerk wherever v + a |a| / (2 J) kept the
velocity's limit before.
"""

from __future__ import annotations

import math

from numba import float64

from guidefield.kernels.jit.signatures import (
    BLOCKS_OUT,
    INDICES_OUT,
    MATRIX,
    SCALAR,
    VECTOR,
    VECTOR_OUT,
    Floats,
    Integers,
    compiled,
    lane_part,
)

MOST_PHASES = 9
"""Of a coordinate: those of a piece, of braking, and standing."""

HALVINGS = 40
"""So often the velocity is halved whose piece and braking end at a given value."""

_REACHED = 1e-10
"""An end that is as close to where it is wanted is there [rad or m]."""


@lane_part
def _change(v: float, a: float, u: float, most: float, jerk: float) -> tuple[float, float, float, float]:
    """The quickest change of velocity: signed jerk of the first part, and how long the three parts last [s].

    Args:
        v: Velocity.
        a: Acceleration.
        u: The velocity that is wanted.
        most: The acceleration's limit.
        jerk: The jerk's limit.
    """
    side = 1.0 if u >= v + 0.5 * a * abs(a) / jerk else -1.0
    rise, b = side * (u - v), side * a
    peak = math.sqrt(max(0.0, jerk * rise + 0.5 * b * b))
    hold = 0.0
    if peak > most:
        peak = most
        hold = max(0.0, (rise - (peak * peak - 0.5 * b * b) / jerk) / most)
    return side * jerk, max(0.0, (peak - b) / jerk), hold, peak / jerk


@lane_part
def _along(q: float, v: float, a: float, j: float, s: float) -> tuple[float, float, float]:
    """Value, velocity and acceleration a time s [s] later, at constant jerk j."""
    return q + s * (v + s * (0.5 * a + s * j / 6.0)), v + s * (a + 0.5 * s * j), a + s * j


@lane_part
def _end_of(q: float, v: float, a: float, u: float, piece: float, most: float, jerk: float) -> float:
    """Where a coordinate stands after a piece towards a velocity u and the hardest braking [rad or m].

    Args:
        q: Its value.
        v: Its velocity.
        a: Its acceleration.
        u: The velocity that the piece is towards.
        piece: How long it lasts [s].
        most: The acceleration's limit.
        jerk: The jerk's limit.
    """
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
    """The velocity from 0 to u whose piece and braking end at a goal, or u if even that doesn't lead beyond it.

    Args:
        q: As in `_end_of`.
        v: As there.
        a: As there.
        u: The velocity that is wanted.
        goal: Not to be passed [rad or m].
        piece: As in `_end_of`.
        most: As there.
        jerk: As there.
    """
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


@compiled(float64(MATRIX, VECTOR, VECTOR, VECTOR, VECTOR, SCALAR, MATRIX, BLOCKS_OUT, INDICES_OUT, VECTOR_OUT))
def piece_and_braking(
    state: Floats,
    velocities: Floats,
    goals: Floats,
    lower: Floats,
    upper: Floats,
    piece: float,
    limits: Floats,
    phases: Floats,
    counts: Integers,
    ends: Floats,
) -> float:
    """The motion of a piece towards velocities, and of the hardest braking after it.

    Args:
        state: Value, velocity and acceleration of each coordinate, shape (nv, 3).
        velocities: Towards which the piece is, shape (nv,).
        goals: Where a coordinate is not led beyond, in the direction of its velocity, shape (nv,); infinite: none.
        lower: Least values, shape (nv,).
        upper: Largest values, shape (nv,).
        piece: How long it lasts [s].
        limits: Velocity, acceleration and jerk of each coordinate, shape (nv, 3).
        phases: Out: beginning from that of the piece [s], value, velocity, acceleration, jerk of each phase, shape (nv,
            `MOST_PHASES`, 5).
        counts: Out: how many each coordinate has, shape (nv,).
        ends: Out: where they stand in the end, shape (nv,).

    Returns:
        When the last one stands [s].
    """
    stops = 0.0
    for k in range(state.shape[0]):
        q, v, a = state[k, 0], state[k, 1], state[k, 2]
        most, jerk = limits[k, 1], limits[k, 2]
        u = min(max(velocities[k], -limits[k, 0]), limits[k, 0])
        if math.isfinite(goals[k]):
            u = _ending_at(q, v, a, u, goals[k], piece, most, jerk)
        edge = upper[k] if u >= 0.0 else lower[k]
        if math.isfinite(edge):
            u = _ending_at(q, v, a, u, edge, piece, most, jerk)
        count, begin = 0, 0.0
        for part in range(2):
            j, first, hold, last = _change(v, a, u if part == 0 else 0.0, most, jerk)
            left = piece if part == 0 else math.inf
            for which in range(4):
                length, rate = first, j
                if which == 1:
                    length, rate = hold, 0.0
                elif which == 2:
                    length, rate = last, -j
                elif which == 3:
                    length, rate = left if part == 0 else 0.0, 0.0
                    if length > 0.0:
                        a = 0.0  # but for rounding it is
                length = min(length, left)
                if length <= 0.0:
                    continue
                row = phases[k, count]
                row[0], row[1], row[2], row[3], row[4] = begin, q, v, a, rate
                q, v, a = _along(q, v, a, rate, length)
                begin, left, count = begin + length, left - length, count + 1
        row = phases[k, count]
        row[0], row[1], row[2], row[3], row[4] = begin, q, 0.0, 0.0, 0.0
        counts[k], ends[k] = count + 1, q
        stops = max(stops, begin)
    return stops
