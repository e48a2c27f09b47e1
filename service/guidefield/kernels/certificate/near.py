"""Which pairs balls, boxes and slabs can't tell to be farther apart than margins: those that Coal is asked about."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import int64

from guidefield.kernels.certificate.slabs import SLAB, UNKNOWN, slab_between
from guidefield.kernels.certificate.tables import OBSTACLES, ROBOT, CertifiedObstacles, CertifiedRobot
from guidefield.kernels.jit.no_refcount import lane_uncounted
from guidefield.kernels.jit.signatures import (
    BLOCKS,
    INDEX_MATRIX,
    INDEX_MATRIX_OUT,
    INDICES,
    MATRIX,
    VECTOR_OUT,
    Floats,
    Integers,
    lane_kernel,
)

SLACK = 1e-9
"""What boxes about balls are wider by, for rounding, of a metre and of each metre that they are from the origin [m]."""

ROW, PAIR, FIRST, SECOND, ASKED = range(5)
"""Numbers of a pair that is asked: its part of the motion, its index and its bodies; then how many there are."""


class _Room(NamedTuple):
    """What the pairs of a part are found in.

    Attributes:
        parts: Centres of the balls about parts of bodies, shape (r, parts, 3) [m, world].
        known: Whether a body's are those of this part of the motion, shape (r,).
        stack: Level and place of boxes of the tree to be looked at, shape (k, 2).
        slab: What a slab is found in, shape (SLAB, 3).
    """

    parts: Floats
    known: np.ndarray
    stack: Integers
    slab: Floats


@lane_uncounted
def _place_parts(robot: CertifiedRobot, b: int, placements: Floats, room: _Room) -> None:
    """Place the balls about parts of a body, once for a part of the motion."""
    if room.known[b]:
        return
    room.known[b] = True
    place = placements[robot.carriers[b]]
    for k in range(robot.part_centres.shape[1]):
        c = robot.part_centres[b, k]
        for i in range(3):
            here = place[4 * i] * c[0] + place[4 * i + 1] * c[1] + place[4 * i + 2] * c[2]
            room.parts[b, k, i] = here + place[4 * i + 3]


@lane_uncounted
def _square(a: Floats, b: Floats) -> float:
    """Squared distance of two points, shapes (3,) [m^2]."""
    x, y, z = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    return float(x * x + y * y + z * z)


@lane_uncounted
def _own_apart(
    robot: CertifiedRobot,
    obstacles: CertifiedObstacles,
    a: int,
    b: int,
    margin: float,
    placements: Floats,
    centres: Floats,
    room: _Room,
) -> float:
    """How far two of the robot's bodies are apart: infinite where balls or a slab tell that it is more than a margin.

    Else what `slab_between` says [m].
    """
    if math.sqrt(_square(centres[a], centres[b])) - robot.radii[a] - robot.radii[b] > margin:
        return np.inf
    _place_parts(robot, a, placements, room)
    _place_parts(robot, b, placements, room)
    least = np.inf
    for i in range(room.parts.shape[1]):
        for j in range(room.parts.shape[1]):
            square = _square(room.parts[a, i], room.parts[b, j])
            if square < least:
                least = square
                for k in range(3):
                    room.slab[0, k] = room.parts[b, j, k] - room.parts[a, i, k]
    if math.sqrt(least) - robot.part_radii[a] - robot.part_radii[b] > margin:
        return np.inf
    apart = slab_between(robot, obstacles, a, b, margin, placements, room.slab)
    return float(apart if apart == np.inf or (robot.filled[a] and robot.filled[b]) else UNKNOWN)


@lane_uncounted
def _gap_square(obstacles: CertifiedObstacles, o: int, point: Floats) -> float:
    """Squared distance of a point (3,) from the box about an obstacle along its own axes: 0 inside [m^2]."""
    axes, square = obstacles.axes[o], 0.0
    for i in range(3):
        along = point[0] * axes[i] + point[1] * axes[3 + i] + point[2] * axes[6 + i]
        beyond = max(abs(along - obstacles.middles[o, i]) - obstacles.halves[o, i], 0.0)
        square += beyond * beyond
    return float(square)


@lane_uncounted
def _to_box(obstacles: CertifiedObstacles, o: int, point: Floats, found: Floats) -> None:
    """The way (3,) from a point (3,) to the box about an obstacle, or, where it is inside, to the box's middle [m]."""
    axes, inside = obstacles.axes[o], True
    for i in range(3):
        found[i] = 0.0
    for i in range(3):
        off = point[0] * axes[i] + point[1] * axes[3 + i] + point[2] * axes[6 + i] - obstacles.middles[o, i]
        beyond = max(abs(off) - obstacles.halves[o, i], 0.0)
        inside = inside and beyond == 0.0
        for k in range(3):
            found[k] -= math.copysign(beyond, off) * axes[3 * k + i]
    if inside:
        for k in range(3):
            found[k] = -point[k]
            for i in range(3):
                found[k] += obstacles.middles[o, i] * axes[3 * k + i]


@lane_uncounted
def _apart(
    robot: CertifiedRobot,
    obstacles: CertifiedObstacles,
    b: int,
    o: int,
    margin: float,
    placements: Floats,
    centre: Floats,
    room: _Room,
) -> float:
    """How far a body and an obstacle are apart: infinite where balls and the box about it, or a slab, tell it.

    That is, that it is more than a margin, which is at least 0; else what `slab_between` says [m].
    """
    if math.sqrt(_gap_square(obstacles, o, centre)) - robot.radii[b] > margin:
        return np.inf
    _place_parts(robot, b, placements, room)
    least, nearest = np.inf, 0
    for k in range(room.parts.shape[1]):
        square = _gap_square(obstacles, o, room.parts[b, k])
        if square < least:
            least, nearest = square, k
    if math.sqrt(least) - robot.part_radii[b] > margin:
        return np.inf
    _to_box(obstacles, o, room.parts[b, nearest], room.slab[0])
    apart = slab_between(robot, obstacles, b, robot.carriers.shape[0] + o, margin, placements, room.slab)
    return float(apart if apart == np.inf or (robot.filled[b] and obstacles.filled[o]) else UNKNOWN)


@lane_uncounted
def _write(asked: Integers, told: Floats, count: int, s: int, pair: int, first: int, second: int, apart: float) -> int:
    """Note a pair where there is room; how many there are by now."""
    if count < asked.shape[0]:
        asked[count, ROW], asked[count, PAIR], asked[count, FIRST], asked[count, SECOND] = s, pair, first, second
        told[count] = apart
    return count + 1


@lane_uncounted
def _below(left_out: Integers, mixed: int) -> int:
    """How many numbers of an ascending array are below one."""
    low, high = 0, left_out.shape[0]
    while low < high:
        middle = (low + high) // 2
        if left_out[middle] < mixed:
            low = middle + 1
        else:
            high = middle
    return low


@lane_uncounted
def _judge(
    robot: CertifiedRobot,
    obstacles: CertifiedObstacles,
    s: int,
    row: int,
    o: int,
    margin: float,
    placements: Floats,
    centre: Floats,
    room: _Room,
    asked: Integers,
    told: Floats,
    count: int,
) -> int:
    """Note the pair of a moving body, by its row, and an obstacle that may be within a margin of it, if it is one."""
    b = robot.moving[row]
    apart = _apart(robot, obstacles, b, o, margin, placements, centre, room)
    if apart == np.inf:
        return count
    mixed, left_out = row * obstacles.axes.shape[0] + o, obstacles.left_out
    at = _below(left_out, mixed)
    if at < left_out.shape[0] and left_out[at] == mixed:
        return count
    pair = robot.own.shape[0] + mixed - at
    return _write(asked, told, count, s, pair, b, robot.carriers.shape[0] + o, apart)


@lane_uncounted
def _among_all(
    robot: CertifiedRobot,
    obstacles: CertifiedObstacles,
    s: int,
    row: int,
    margin: float,
    placements: Floats,
    centre: Floats,
    room: _Room,
    asked: Integers,
    told: Floats,
    count: int,
) -> int:
    """Note the pairs of a moving body, by its row, with all obstacles that may be within a margin of it [m]."""
    for k in range(obstacles.endless.shape[0]):
        o = obstacles.endless[k]
        count = _judge(robot, obstacles, s, row, o, margin, placements, centre, room, asked, told, count)
    reach = robot.radii[robot.moving[row]] + margin
    x = reach + SLACK * (1.0 + abs(centre[0]))
    y = reach + SLACK * (1.0 + abs(centre[1]))
    z = reach + SLACK * (1.0 + abs(centre[2]))
    levels, nodes, waiting = obstacles.levels, obstacles.nodes, 0
    top = levels.shape[0] - 2
    for k in range(levels[top + 1] - levels[top]):
        room.stack[waiting, 0], room.stack[waiting, 1] = top, k
        waiting += 1
    while waiting > 0:
        waiting -= 1
        level, k = room.stack[waiting, 0], room.stack[waiting, 1]
        box = nodes[levels[level] + k]
        if (
            box[0] > centre[0] + x
            or box[3] < centre[0] - x
            or box[1] > centre[1] + y
            or box[4] < centre[1] - y
            or box[2] > centre[2] + z
            or box[5] < centre[2] - z
        ):
            continue
        if level == 0:
            o = obstacles.order[k]
            count = _judge(robot, obstacles, s, row, o, margin, placements, centre, room, asked, told, count)
            continue
        below = levels[level] - levels[level - 1]
        for child in range(obstacles.children * k, min(obstacles.children * (k + 1), below)):
            room.stack[waiting, 0], room.stack[waiting, 1] = level - 1, child
            waiting += 1
    return count


@lane_kernel(
    int64(ROBOT, OBSTACLES, BLOCKS, BLOCKS, MATRIX, MATRIX, INDICES, INDEX_MATRIX, INDEX_MATRIX_OUT, VECTOR_OUT)
)
def find_near(
    robot: CertifiedRobot,
    obstacles: CertifiedObstacles,
    placements: Floats,
    centres: Floats,
    own: Floats,
    mixed: Floats,
    starts: Integers,
    left: Integers,
    asked: Integers,
    told: Floats,
) -> int:
    """Find the pairs in s parts of a motion that balls, boxes and slabs can't tell to keep their margins.

    Args:
        robot: The robot.
        obstacles: The obstacles.
        placements: ``T_world_joint`` of every joint at the parts' middles, shape (s, joints, 12) [m].
        centres: Centres there of the balls about bodies, shape (s, r, 3) [m, world].
        own: Margins of the robot's own pairs, at least 0, shape (s, p) [m].
        mixed: Margins of its bodies and obstacles, at least 0, shape (s, r) [m].
        starts: Where the pairs that are left of each part begin, and the number of all, shape (s + 1,); where none are,
            all pairs are meant.
        left: Index and bodies of pairs that are left, shape (k, 3).
        asked: Out: part, index and bodies of each of those pairs, shape (room, `ASKED`).
        told: Out: how far apart each is at most, but for Coal's accuracy, shape (room,) [m]; `UNKNOWN` where that isn't
            known.

    Returns:
        How many there are; those for which there is no room are not written.
    """
    r, most = robot.part_centres.shape[0], obstacles.children * obstacles.levels.shape[0]
    room = _Room(
        np.empty((r, robot.part_centres.shape[1], 3)),
        np.zeros(r, np.bool_),
        np.empty((most, 2), np.int64),
        np.empty((SLAB, 3)),
    )
    count = 0
    for s in range(placements.shape[0]):
        room.known[:] = False
        if starts[s] == starts[s + 1]:
            for k in range(robot.own.shape[0]):
                a, b = robot.own[k, 0], robot.own[k, 1]
                apart = _own_apart(robot, obstacles, a, b, own[s, k], placements[s], centres[s], room)
                if apart < np.inf:
                    count = _write(asked, told, count, s, k, a, b, apart)
            for row in range(robot.moving.shape[0]):
                b = robot.moving[row]
                count = _among_all(
                    robot, obstacles, s, row, mixed[s, b], placements[s], centres[s, b], room, asked, told, count
                )
        for k in range(starts[s], starts[s + 1]):
            pair, a, b = left[k, 0], left[k, 1], left[k, 2]
            if pair < robot.own.shape[0]:
                apart = _own_apart(robot, obstacles, a, b, own[s, pair], placements[s], centres[s], room)
            else:
                o = b - robot.carriers.shape[0]
                apart = _apart(robot, obstacles, a, o, mixed[s, a], placements[s], centres[s, a], room)
            if apart < np.inf:
                count = _write(asked, told, count, s, pair, a, b, apart)
    return count
