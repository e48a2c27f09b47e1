"""Ways of a stream: a tree from each end among boxes that are grown, then short cuts; beside the cycle.

What rests, and the robot itself, is judged by the lanes' samples; what moves by balls and boxes at the same samples.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import boolean, int64

from guidefield.kernels.collide.motion_validation import path_free_until
from guidefield.kernels.jit.fields import Indices, Row, Rows, numba_type
from guidefield.kernels.jit.signatures import (
    MATRIX,
    MATRIX_OUT,
    SCALAR,
    VECTOR,
    Floats,
    Integers,
    compiled,
    inlined,
)
from guidefield.kernels.stream.room import RoomRobot, blocked

CONNECTING = 64
"""A tree grows towards the other by so many edges at once at most."""


class Surroundings(NamedTuple):
    """A robot among what rests and what moves, and how closely ways there are looked at.

    Attributes:
        robot: The robot, for what moves.
        words: The robot among what rests, a packed `LaneWorld`.
        clearance: What to keep from what rests [m].
        boxes: What moves, now, shape (k, 16) [m, world].
        drifts: How fast each goes straight on, shape (k, 3) [m/s].
        grown: What to keep from each, shape (k,) [m].
        ends: The way's ends, shape (2, nv).
        gaps: What may be kept from each at the ends, shape (2, k) [m]; `widening` more for each second from there.
        speeds: Of the coordinates, at most, shape (nv,) [rad/s or m/s].
        horizon: So far it is foreseen where boxes are when the robot could come at the soonest [s].
        widening: See `gaps` [m/s].
        spacing: Of the samples along a way [rad or m].
    """

    robot: RoomRobot
    words: Indices
    clearance: float
    boxes: Rows
    drifts: Rows
    grown: Row
    ends: Rows
    gaps: Rows
    speeds: Row
    horizon: float
    widening: float
    spacing: float


SURROUNDINGS = numba_type(Surroundings)


@inlined
def _taken(among: Surroundings, z: Floats, moved: Floats, grown: Floats) -> bool:
    """Tell if a box will be too close to coordinates z, shape (nv,), when the robot could be there at the soonest.

    Args:
        among: What it is to be free of.
        z: The coordinates.
        moved: Memory: the boxes then, shape (k, 16), with what never changes in it.
        grown: Memory: what is kept from each, shape (k,).
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


@compiled(boolean(SURROUNDINGS, VECTOR, VECTOR))
def straight_free(among: Surroundings, z0: Floats, z1: Floats) -> bool:
    """Tell if the straight way between two points is free, by samples; the first point itself isn't looked at.

    Args:
        among: What it is to be free of.
        z0: Coordinates of one end, shape (nv,).
        z1: Of the other, shape (nv,).
    """
    nv, square = z0.shape[0], 0.0
    rows = np.empty((2, nv), np.float32)
    for j in range(nv):
        square += (z1[j] - z0[j]) ** 2
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
                if _taken(among, z, moved, grown):
                    return False
            at += stride
        stride //= 2
    return bool(path_free_until(among.words, among.clearance, rows, 1.0 / among.spacing) == 1)


@inlined
def _closest(nodes: Floats, count: int, z: Floats) -> int:
    """Return which of some nodes, rows of shape (n, nv), is closest to z, shape (nv,)."""
    best, least = 0, np.inf
    for i in range(count):
        square = 0.0
        for j in range(z.shape[0]):
            square += (nodes[i, j] - z[j]) ** 2
        if square < least:
            best, least = i, square
    return best


@inlined
def _grown(
    among: Surroundings,
    nodes: Floats,
    parents: Integers,
    size: int,
    towards: Floats,
    longest: float,
    steps: int,
) -> tuple[int, bool]:
    """Grow a tree from its closest point towards another one, an edge after the other.

    Args:
        among: What it is to be free of.
        nodes: The tree's points, shape (n, nv).
        parents: Shape (n,).
        size: How many there are.
        towards: Where to, shape (nv,).
        longest: An edge is at most so long [rad or m].
        steps: How many edges there may be.

    Returns:
        How many points there are then, and whether the last one is where it was to grow to.
    """
    nv = towards.shape[0]
    at = _closest(nodes, size, towards)
    for _ in range(steps):
        square = 0.0
        for j in range(nv):
            square += (towards[j] - nodes[at, j]) ** 2
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
def _joined(nodes: Floats, parents: Integers, first: int, second: int, path: Floats) -> int:
    """The way through both trees, where a point of the one is where one of the other is; how many points it has.

    Args:
        nodes: Points of both, shape (2, n, nv).
        parents: Shape (2, n).
        first: The point of the first tree.
        second: That of the second.
        path: Out: the way, shape (m, nv).

    Returns:
        0 where there is no room for it.
    """
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


@compiled(int64(SURROUNDINGS, VECTOR, VECTOR, SCALAR, MATRIX, MATRIX_OUT))
def way_between(among: Surroundings, z0: Floats, z1: Floats, longest: float, samples: Floats, path: Floats) -> int:
    """A way between two points by two trees that grow towards each other (Kuffner and LaValle).

    Args:
        among: What it is to be free of.
        z0: Coordinates of one end, shape (nv,).
        z1: Of the other, shape (nv,).
        longest: An edge of the trees is at most so long [rad or m].
        samples: The points that they grow to, shape (n, nv).
        path: Out: the way from z0 to z1, shape (m, nv).

    Returns:
        How many points the way has; 0: none was found.
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
        sizes[a], _ = _grown(among, nodes[a], parents[a], before, samples[turn], longest, 1)
        if sizes[a] == before:
            continue
        towards = nodes[a, before]
        sizes[b], met = _grown(among, nodes[b], parents[b], sizes[b], towards, longest, CONNECTING)
        if met:
            return _joined(nodes, parents, sizes[0] - 1, sizes[1] - 1, path)
    return 0


@compiled(int64(SURROUNDINGS, MATRIX, int64, MATRIX_OUT))
def cut_short(among: Surroundings, drawn: Floats, count: int, path: Floats) -> int:
    """A way with straight pieces between places on it where they are free, in place; how many points it has then.

    Args:
        among: What it is to be free of.
        drawn: Two places each to be tried, as numbers from 0 to 1, shape (n, 4).
        count: How many points the way has.
        path: The way, shape (m, nv).
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
