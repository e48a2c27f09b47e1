"""Pairs of bodies that may touch where a robot stands: by balls about its bodies and their parts, and boxes."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import int64

from guidefield.kernels.distance.bvh import boxes_met
from guidefield.kernels.jit.fields import Blocks, IndexRows, Indices, Row, Rows, numba_type
from guidefield.kernels.jit.no_refcount import lane_uncounted
from guidefield.kernels.jit.signatures import (
    BLOCKS,
    INDEX_MATRIX_OUT,
    INDICES,
    SCALAR,
    Floats,
    Integers,
    lane_kernel,
)

WIDER = 1e-9
"""Margin of boxes about balls, for rounding, of a metre and of each metre that they are from the origin [m]."""


class BalledRobot(NamedTuple):
    """Balls about a robot's r bodies, and its own p pairs.

    Attributes:
        carriers: The joint that carries each body, shape (r,).
        centres: Centres of the balls about bodies in the frame of that joint, shape (r, 3) [m].
        radii: Their radii, shape (r,) [m].
        part_centres: Centres of balls that together hold a body, in the same frame, shape (r, parts, 3) [m].
        part_radii: Their radii, shape (r,) [m].
        own: Bodies of the robot's own pairs, shape (p, 2).
        moving: The bodies that are tested against obstacles, ascending, shape (m,).
    """

    carriers: Indices
    centres: Rows
    radii: Row
    part_centres: Blocks
    part_radii: Row
    own: IndexRows
    moving: Indices


class BoxedObstacles(NamedTuple):
    """Boxes about o obstacles: their own ones, and a tree of boxes along the world's axes.

    Attributes:
        axes: The axes of their own boxes as columns, row by row, shape (o, 9).
        middles: Centres along these, shape (o, 3) [m].
        halves: Half extents, shape (o, 3) [m]; infinite for those without an end.
        nodes, levels: Of the tree, as `collision.box_tree.BoxTree` has them, shapes (k, 6) [m, world], (levels + 1,).
        children: Of how many of its boxes one of the next level is made.
        order: The obstacle of each box of the first level.
        endless: The obstacles that are in no box, shape (e,).
        left_out: Pairs with obstacles that may touch; see `collision.pairs.Pairs`.
    """

    axes: Rows
    middles: Rows
    halves: Rows
    nodes: Rows
    levels: Indices
    children: int
    order: Indices
    endless: Indices
    left_out: Indices


ROBOT, OBSTACLES = map(numba_type, (BalledRobot, BoxedObstacles))


@lane_uncounted
def _place(place: Floats, point: Floats, found: Floats) -> None:
    """Place a point (3,) of the frame of a joint that stands somewhere, (12,), in the world [m]."""
    for i in range(3):
        here = place[4 * i] * point[0] + place[4 * i + 1] * point[1] + place[4 * i + 2] * point[2]
        found[i] = here + place[4 * i + 3]


@lane_uncounted
def _place_parts(robot: BalledRobot, b: int, placements: Floats, parts: Floats) -> None:
    """Place the balls about parts of a body, shape (parts, 3)."""
    for k in range(robot.part_centres.shape[1]):
        _place(placements[robot.carriers[b]], robot.part_centres[b, k], parts[k])


@lane_uncounted
def _distance(a: Floats, b: Floats) -> float:
    """Distance of two points, shapes (3,) [m]."""
    x, y, z = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    return math.sqrt(x * x + y * y + z * z)


@lane_uncounted
def _gap(obstacles: BoxedObstacles, o: int, point: Floats) -> float:
    """Distance of a point (3,) from the box about an obstacle along its own axes: 0 inside [m]."""
    axes, square = obstacles.axes[o], 0.0
    for i in range(3):
        along = point[0] * axes[i] + point[1] * axes[3 + i] + point[2] * axes[6 + i]
        beyond = max(abs(along - obstacles.middles[o, i]) - obstacles.halves[o, i], 0.0)
        square += beyond * beyond
    return math.sqrt(square)


@lane_uncounted
def _are_own_near(
    robot: BalledRobot, a: int, b: int, margin: float, placements: Floats, centres: Floats, parts: Floats
) -> bool:
    """Tell if balls can't tell two of the robot's bodies to be farther apart than a margin."""
    if _distance(centres[a], centres[b]) - robot.radii[a] - robot.radii[b] > margin:
        return False
    _place_parts(robot, a, placements, parts[0])
    _place_parts(robot, b, placements, parts[1])
    reach = margin + robot.part_radii[a] + robot.part_radii[b]
    for i in range(parts.shape[1]):
        for j in range(parts.shape[1]):
            if _distance(parts[0, i], parts[1, j]) <= reach:
                return True
    return False


@lane_uncounted
def _is_near(
    robot: BalledRobot,
    obstacles: BoxedObstacles,
    b: int,
    o: int,
    margin: float,
    placements: Floats,
    centre: Floats,
    parts: Floats,
) -> bool:
    """The same of a body and an obstacle, by its balls and the obstacle's own box."""
    if _gap(obstacles, o, centre) - robot.radii[b] > margin:
        return False
    _place_parts(robot, b, placements, parts[0])
    least = np.inf
    for k in range(parts.shape[1]):
        least = min(least, _gap(obstacles, o, parts[0, k]))
    return bool(least - robot.part_radii[b] <= margin)


@lane_uncounted
def _pair(robot: BalledRobot, obstacles: BoxedObstacles, row: int, o: int) -> int:
    """The index of the pair of a moving body, by its row, and an obstacle; -1 where it is left out."""
    mixed, left_out = row * obstacles.axes.shape[0] + o, obstacles.left_out
    low, high = 0, left_out.shape[0]
    while low < high:
        middle = (low + high) // 2
        if left_out[middle] < mixed:
            low = middle + 1
        else:
            high = middle
    return -1 if low < left_out.shape[0] and left_out[low] == mixed else robot.own.shape[0] + mixed - low


@lane_uncounted
def _note(found: Integers, count: int, s: int, pair: int) -> int:
    """Note a pair where there is room; how many there are by now."""
    if count < found.shape[0]:
        found[count, 0], found[count, 1] = s, pair
    return count + 1


@lane_uncounted
def _obstacles_met(
    obstacles: BoxedObstacles, centre: Floats, reach: float, box: Floats, stack: Integers, met: Integers
) -> int:
    """Find the obstacles whose boxes meet the one about a ball that reaches so far, shape (o,); how many there are.

    `box`, shape (2, 3), is scratch for the corners of that one, which is a hair wider.
    """
    for i in range(3):
        wide = reach + WIDER * (1.0 + abs(centre[i]))
        box[0, i], box[1, i] = centre[i] - wide, centre[i] + wide
    count = boxes_met(obstacles.nodes, obstacles.levels, obstacles.children, box[0], box[1], stack, met)
    for k in range(count):
        met[k] = obstacles.order[met[k]]
    for k in range(obstacles.endless.shape[0]):
        met[count] = obstacles.endless[k]
        count += 1
    return count


@lane_kernel(int64(ROBOT, OBSTACLES, BLOCKS, SCALAR, INDICES, INDICES, INDEX_MATRIX_OUT))
def find_near_pairs(
    robot: BalledRobot,
    obstacles: BoxedObstacles,
    placements: Floats,
    margin: float,
    own: Integers,
    moving: Integers,
    found: Integers,
) -> int:
    """Find the pairs at s configurations that balls and boxes can't tell to be farther apart than a margin.

    Args:
        robot: The robot.
        obstacles: The obstacles.
        placements: ``T_world_joint`` of every joint, shape (s, joints, 12) [m].
        margin: At least 0 [m].
        own: Which of the robot's own pairs are asked about, ascending, shape (k,).
        moving: Which rows of its moving bodies are, with obstacles, ascending, shape (k,).
        found: Out: configuration and pair, shape (room, 2); by configuration, not by pair.

    Returns:
        How many there are; those for which there is no room are not written.
    """
    centres, parts = np.empty((robot.radii.shape[0], 3)), np.empty((2, robot.part_centres.shape[1], 3))
    stack = np.empty((obstacles.children * obstacles.levels.shape[0], 2), np.int64)
    box, met, count = np.empty((2, 3)), np.empty(obstacles.axes.shape[0], np.int64), 0
    for s in range(placements.shape[0]):
        for b in range(centres.shape[0]):
            _place(placements[s, robot.carriers[b]], robot.centres[b], centres[b])
        for k in own:
            if _are_own_near(robot, robot.own[k, 0], robot.own[k, 1], margin, placements[s], centres, parts):
                count = _note(found, count, s, k)
        for row in moving:
            b = robot.moving[row]
            for k in range(_obstacles_met(obstacles, centres[b], robot.radii[b] + margin, box, stack, met)):
                pair = _pair(robot, obstacles, row, met[k])
                if pair >= 0 and _is_near(robot, obstacles, b, met[k], margin, placements[s], centres[b], parts):
                    count = _note(found, count, s, pair)
    return count
