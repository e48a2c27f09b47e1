"""Paths of a stream: a tree from each end among grown boxes, then shortcuts; in the background of the cycle.

What rests, and the robot itself, is judged by samples of SIMD batches; what moves by balls and boxes at the same
samples.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from guidefield.kernels.collide.batch_collision import path_free_until
from guidefield.kernels.jit.arrays import (
    BlocksOut,
    Floats,
    Indices,
    IndicesOut,
    Integers,
    Row,
    RowOut,
    Rows,
    RowsOut,
    numba_type,
)
from guidefield.kernels.jit.decorators import inlined, kernel, lane_part
from guidefield.kernels.stream.room import RoomRobot, blocked

CONNECTING = 64  # a tree grows towards the other by so many edges at once at most


class Surroundings(NamedTuple):
    """A robot among what rests and what moves, and how closely ways there are looked at."""

    robot: RoomRobot  # the robot, for what moves
    words: Indices  # the robot among what rests, a packed `LaneWorld`
    clearance: float  # what to keep from what rests [m]
    boxes: Rows  # what moves, now, shape (k, 16) [m, world]
    drifts: Rows  # how fast each goes straight on, shape (k, 3) [m/s]
    grown: Row  # what to keep from each, shape (k,) [m]
    ends: Rows  # the way's ends, shape (2, nv)
    gaps: Rows  # what may be kept from each at the ends, shape (2, k) [m]; `widening` more for each second from there
    speeds: Row  # of the coordinates, at most, shape (nv,) [rad/s or m/s]
    horizon: float  # so far it is foreseen where boxes are when the robot could come at the soonest [s]
    widening: float  # see `gaps` [m/s]
    spacing: float  # of the samples along a way [rad, or m at size 1]
    sizes: Row  # how far each coordinate goes for a length of 1: 1 for angles, the size for what slides, shape (nv,)


SURROUNDINGS = numba_type(Surroundings)


@inlined
def _is_taken(among: Surroundings, z: Floats, moved: Floats, grown: Floats) -> bool:
    """Tell if a box will be too close to coordinates z when the robot could be there at the soonest.

    Memory: the boxes then, with what never changes in them, and what is kept from each.
    """
    first, last = 0.0, 0.0
    for j in range(z.shape[0]):
        first = max(first, abs(z[j] - among.ends[0, j]) / among.speeds[j])
        last = max(last, abs(z[j] - among.ends[1, j]) / among.speeds[j])
    then = min(first, among.horizon)
    for k in range(moved.shape[0]):
        for r in range(3):
            moved[k, 4 * r + 3] = among.boxes[k, 4 * r + 3] + then * among.drifts[k, r]
        kept = min(among.gaps[0, k] + among.widening * first, among.gaps[1, k] + among.widening * last)
        grown[k] = min(among.grown[k], kept)
    return bool(blocked(among.robot, moved, grown, z))


@kernel
def straight_free(among: Surroundings, z0: Row, z1: Row) -> bool:
    """Tell if the straight way between two points (nv,) is free, by samples; the first point itself isn't looked at."""
    nv, square = z0.shape[0], 0.0
    rows = np.empty((2, nv), np.float32)
    for j in range(nv):
        square += ((z1[j] - z0[j]) / among.sizes[j]) ** 2
        rows[0, j], rows[1, j] = z0[j], z1[j]
    count = max(1, math.ceil(math.sqrt(square) / among.spacing))
    z, moved = np.empty(nv), among.boxes.copy()
    grown = np.empty(moved.shape[0])
    # the ends of halves first: what is in the way is found sooner
    stride = 1
    while stride < count:
        stride *= 2
    at = stride
    while stride >= 1:
        at = stride
        while at < count + stride:
            if (at // stride) % 2 == 1 or at >= count:
                share = min(1.0, at / count)
                for j in range(nv):
                    z[j] = z0[j] + share * (z1[j] - z0[j])
                if _is_taken(among, z, moved, grown):
                    return False
            at += stride
        stride //= 2
    return bool(path_free_until(among.words, among.clearance, rows, 1.0 / among.spacing) == 1)


@inlined
def _closest(nodes: Floats, count: int, z: Floats, sizes: Floats) -> int:
    """Return which of some nodes, rows of shape (n, nv), is closest to z, shape (nv,)."""
    best, least = 0, np.inf
    for i in range(count):
        square = 0.0
        for j in range(z.shape[0]):
            square += ((nodes[i, j] - z[j]) / sizes[j]) ** 2
        if square < least:
            best, least = i, square
    return best


@inlined
def _grow(
    among: Surroundings,
    nodes: Floats,
    parents: Integers,
    size: int,
    towards: Floats,
    longest: float,
    steps: int,
) -> tuple[int, bool]:
    """Grow a tree from its closest point towards another one, by edges of at most `longest` [rad, or m at size 1].

    Returns how many points there are then, and whether the last one is where it was to grow to.
    """
    nv = towards.shape[0]
    at = _closest(nodes, size, towards, among.sizes)
    for _ in range(steps):
        square = 0.0
        for j in range(nv):
            square += ((towards[j] - nodes[at, j]) / among.sizes[j]) ** 2
        length = math.sqrt(square)
        share = min(1.0, longest / length) if length > 0.0 else 1.0
        if size == nodes.shape[0]:
            return size, False
        for j in range(nv):
            nodes[size, j] = nodes[at, j] + share * (towards[j] - nodes[at, j])
        if not straight_free(among, nodes[at], nodes[size]):
            return size, False
        parents[size] = at
        at, size = size, size + 1
        if share == 1.0:
            return size, True
    return size, False


@inlined
def _join(nodes: Floats, parents: Integers, first: int, second: int, path: Floats) -> int:
    """Write the way through both trees, where a point of the one is one of the other; its points, 0 without room."""
    count, node = 0, first
    while node >= 0:
        count, node = count + 1, parents[0, node]
    if count > path.shape[0]:
        return 0
    node = first
    for k in range(count - 1, -1, -1):
        path[k] = nodes[0, node]
        node = parents[0, node]
    node = parents[1, second]
    while node >= 0:
        if count == path.shape[0]:
            return 0
        path[count] = nodes[1, node]
        count, node = count + 1, parents[1, node]
    return count


@kernel
def way_between(among: Surroundings, z0: Row, z1: Row, longest: float, samples: Rows, path: RowsOut) -> int:
    """Find a path (m, nv) between two points (nv,) by two trees that grow towards each other.

    Return its count of points. After Kuffner and LaValle, towards `samples` (n, nv), with edges of at most `longest`
    [rad or m]; 0: none was found.
    """
    nv = z0.shape[0]
    path[0], path[1] = z0, z1
    if straight_free(among, z0, z1):
        return 2
    room = 10 * samples.shape[0] + 1
    nodes, parents = np.empty((2, room, nv)), np.empty((2, room), np.int64)
    sizes = np.ones(2, np.int64)
    nodes[0, 0], nodes[1, 0] = z0, z1
    parents[:, 0] = -1
    for turn in range(samples.shape[0]):
        a, b = turn % 2, 1 - turn % 2
        before = sizes[a]
        sizes[a], _ = _grow(among, nodes[a], parents[a], before, samples[turn], longest, 1)
        if sizes[a] == before:
            continue
        towards = nodes[a, before]
        sizes[b], met = _grow(among, nodes[b], parents[b], sizes[b], towards, longest, CONNECTING)
        if met:
            return _join(nodes, parents, sizes[0] - 1, sizes[1] - 1, path)
    return 0


@kernel
def cut_short(among: Surroundings, drawn: Rows, count: int, path: RowsOut) -> int:
    """Shorten a path (m, nv) in place by straight pieces between places on it where they are free; return its points.

    `drawn` (n, 4) are two places each to be tried, as numbers from 0 to 1.
    """
    nv = path.shape[1]
    p, q = np.empty(nv), np.empty(nv)
    for turn in range(drawn.shape[0]):
        if count < 3:
            break
        i, k = min(int(drawn[turn, 0] * (count - 1)), count - 2), min(int(drawn[turn, 1] * (count - 1)), count - 2)
        s, t = drawn[turn, 2], drawn[turn, 3]
        if i > k:
            i, k = k, i
        if i == k or count + 2 > path.shape[0]:
            continue
        for j in range(nv):
            p[j] = path[i, j] + s * (path[i + 1, j] - path[i, j])
            q[j] = path[k, j] + t * (path[k + 1, j] - path[k, j])
        if not straight_free(among, p, q):
            continue
        # rows i + 1 .. k give way to p and q
        shift = 2 - (k - i)
        if shift > 0:
            for row in range(count - 1, k, -1):
                path[row + shift] = path[row]
        else:
            for row in range(k + 1, count):
                path[row + shift] = path[row]
        path[i + 1], path[i + 2] = p, q
        count += shift
    return count


MOST_PHASES = 9  # of a coordinate: those of a piece, of braking, and standing
HALVINGS = 40  # so often the velocity is halved whose piece and braking end at a given value
SOFTENINGS = 12  # so often the share of the limits is halved with which a coordinate takes as long as the slowest one
_REACHED = 1e-10  # an end that is as close to where it is wanted is there [rad or m]


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
    """Where a coordinate stands after a piece [s] towards a velocity u and the hardest braking [rad or m]."""
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

    They stay as they are where the end wouldn't keep `lower` and `upper`; `lasts` is infinite until u is reached.
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
        # who changes less takes as long as the slowest, so that all go straight on together
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
