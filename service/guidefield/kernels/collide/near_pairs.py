"""Pairs of bodies that may be closer than a margin at a configuration, by balls about bodies and parts, and boxes.

The broad phase of distances and of proofs: its tables are filled by `collision/pairs.py`, `bodies.py` and
`obstacle_boxes.py`. It may keep a pair that is far, but never drop a near one. Numbers of pairs count the own pairs
first, then those with obstacles without `left_out`; proofs name pairs by them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from guidefield.kernels.distance.bvh import boxes_met
from guidefield.kernels.jit.arrays import Blocks, Floats, IndexRows, IndexRowsOut, Indices, Integers, Row, Rows
from guidefield.kernels.jit.decorators import uncounted, vector_kernel, vector_uncounted

WIDER = 1e-9
"""Margin of boxes about balls, for rounding, of a metre and of each metre that they are from the origin [m]: it
may grow, not shrink."""


class BodyBalls(NamedTuple):
    """Balls about a robot's r bodies."""

    parent_joints: Indices  # the joint that carries each body, shape (r,)
    centres: Rows  # centres of the balls about bodies in the frame of that joint, shape (r, 3) [m]
    radii: Row  # their radii, shape (r,) [m]
    part_centres: Blocks  # centres of balls that together hold a body, in the same frame, shape (r, parts, 3) [m]
    part_radii: Row  # their radii, shape (r,) [m]


class BoxedObstacles(NamedTuple):
    """Boxes about o obstacles: their own ones, and a tree of boxes along the world's axes."""

    axes: Rows  # the axes of their own boxes as columns, row by row, shape (o, 9)
    centres: Rows  # centres along these, shape (o, 3) [m]
    halves: Rows  # half extents, shape (o, 3) [m]; infinite for those without an end
    # lower and upper corners of the tree's boxes, shape (k, 6) [m, world]: those about obstacles, then those about
    # every `children` of the level before
    nodes: Rows
    levels: Indices  # begin of each level among them, and the number of all, shape (levels + 1,)
    children: int  # boxes below one box of the next level
    order: Indices  # the obstacle of each box of the first level
    apart: Indices  # the obstacles that are in no box, as they have no end, or move, shape (e,)


class PairTable(NamedTuple):
    """Pairs that must stay apart: p of the robot's own, then each of m bodies with each of o obstacles, row by row."""

    own: IndexRows  # bodies of each own pair, shape (p, 2)
    moving: Indices  # the bodies that are tested against obstacles, ascending, shape (m,)
    left_out: Indices  # of the m * o pairs with obstacles those that may touch, ascending, shape (k,)


@vector_uncounted
def _place(place: Floats, point: Floats, found: Floats) -> None:
    """Write the place of a point (3,), in the frame of a joint placed at (12,), in the world [m]."""
    for i in range(3):
        here = place[4 * i] * point[0] + place[4 * i + 1] * point[1] + place[4 * i + 2] * point[2]
        found[i] = here + place[4 * i + 3]


@vector_uncounted
def _place_parts(robot: BodyBalls, b: int, placements: Floats, parts: Floats) -> None:
    """Place the balls about parts of a body, shape (parts, 3)."""
    for k in range(robot.part_centres.shape[1]):
        _place(placements[robot.parent_joints[b]], robot.part_centres[b, k], parts[k])


@vector_uncounted
def _distance(a: Floats, b: Floats) -> float:
    x, y, z = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    return math.sqrt(x * x + y * y + z * z)


@uncounted
def squared_gap_to_box(obstacles: BoxedObstacles, o: int, x: float, y: float, z: float) -> float:
    """Return the squared distance of a point from the box about an obstacle along its own axes: 0 inside [m^2]."""
    axes, square = obstacles.axes[o], 0.0
    for k in range(3):
        along = axes[k] * x + axes[3 + k] * y + axes[6 + k] * z
        beyond = max(abs(along - obstacles.centres[o, k]) - obstacles.halves[o, k], 0.0)
        square += beyond * beyond
    return square


@vector_uncounted
def _gap(obstacles: BoxedObstacles, o: int, point: Floats) -> float:
    """Distance of a point (3,) from the box about an obstacle along its own axes [m]."""
    return math.sqrt(squared_gap_to_box(obstacles, o, point[0], point[1], point[2]))


@vector_uncounted
def _are_own_near(
    robot: BodyBalls, a: int, b: int, margin: float, placements: Floats, centres: Floats, parts: Floats
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


@vector_uncounted
def _is_near(
    robot: BodyBalls,
    obstacles: BoxedObstacles,
    b: int,
    o: int,
    margin: float,
    placements: Floats,
    centre: Floats,
    parts: Floats,
) -> bool:
    """Tell if a body's balls and an obstacle's own box can't tell the two to be farther apart than a margin."""
    if _gap(obstacles, o, centre) - robot.radii[b] > margin:
        return False
    _place_parts(robot, b, placements, parts[0])
    least = np.inf
    for k in range(parts.shape[1]):
        least = min(least, _gap(obstacles, o, parts[0, k]))
    return bool(least - robot.part_radii[b] <= margin)


@vector_uncounted
def count_left_out(left_out: Integers, mixed: int) -> int:
    """Return how many pairs that may touch, shape (k,), are before one with an obstacle: a binary search."""
    low, high = 0, left_out.shape[0]
    while low < high:
        middle = (low + high) // 2
        if left_out[middle] < mixed:
            low = middle + 1
        else:
            high = middle
    return low


@vector_uncounted
def is_left_out(left_out: Integers, mixed: int) -> bool:
    """Return whether a pair with an obstacle, by its number among those, is one of those that may touch, shape (k,)."""
    before = count_left_out(left_out, mixed)
    return bool(before < left_out.shape[0] and left_out[before] == mixed)


@vector_uncounted
def _note(found: Integers, count: int, s: int, pair: int) -> int:
    """Note a pair if the capacity allows; how many there are by now."""
    if count < found.shape[0]:
        found[count, 0], found[count, 1] = s, pair
    return count + 1


@vector_uncounted
def find_boxes_near(
    obstacles: BoxedObstacles, centre: Floats, reach: float, box: Floats, stack: Integers, met_out: Integers
) -> int:
    """Write the obstacles (o,) of the tree whose boxes meet the one about a ball at (3,) [m]; return their number.

    Scratch: `box` (2, 3), a hair wider than the ball, and `stack` (children * levels, 2) at least.
    """
    for k in range(3):
        wide = reach + WIDER * (1.0 + abs(centre[k]))
        box[0, k], box[1, k] = centre[k] - wide, centre[k] + wide
    count = boxes_met(obstacles.nodes, obstacles.levels, obstacles.children, box[0], box[1], stack, met_out)
    for k in range(count):
        met_out[k] = obstacles.order[met_out[k]]
    return count


@vector_kernel
def find_near_pairs(
    robot: BodyBalls,
    obstacles: BoxedObstacles,
    pairs: PairTable,
    placements: Blocks,
    margin: float,
    own: Indices,
    moving: Indices,
    found: IndexRowsOut,
) -> int:
    """Write the pairs at configurations that balls and boxes can't tell to be farther apart than a margin [m].

    `placements` (s, joints, 12) are ``T_world_joint`` [m]; asked about are the `own` pairs (k,) and the rows `moving`
    (k,) of moving bodies, ascending. `found` (capacity, 2) gets configuration and pair, by configuration, not by pair.
    Returns the count, also of those beyond the capacity.
    """
    centres, parts = np.empty((robot.radii.shape[0], 3)), np.empty((2, robot.part_centres.shape[1], 3))
    stack = np.empty((obstacles.children * obstacles.levels.shape[0], 2), np.int64)
    box, met, count = np.empty((2, 3)), np.empty(obstacles.axes.shape[0], np.int64), 0
    for s in range(placements.shape[0]):
        for b in range(centres.shape[0]):
            _place(placements[s, robot.parent_joints[b]], robot.centres[b], centres[b])
        for k in own:
            if _are_own_near(robot, pairs.own[k, 0], pairs.own[k, 1], margin, placements[s], centres, parts):
                count = _note(found, count, s, k)
        for row in moving:
            b = pairs.moving[row]
            boxed = find_boxes_near(obstacles, centres[b], robot.radii[b] + margin, box, stack, met)
            for k in range(boxed + obstacles.apart.shape[0]):
                o = met[k] if k < boxed else obstacles.apart[k - boxed]
                mixed = row * obstacles.axes.shape[0] + o
                if is_left_out(pairs.left_out, mixed):
                    continue
                if _is_near(robot, obstacles, b, o, margin, placements[s], centres[b], parts):
                    count = _note(found, count, s, pairs.own.shape[0] + mixed - count_left_out(pairs.left_out, mixed))
    return count
