"""Pairs that can come within a distance in a segment: by bounding spheres, boxes and a tree of boxes."""

from __future__ import annotations

import math

from guidefield.kernels.jit.no_refcount import uncounted
from guidefield.kernels.jit.signatures import Floats, Integers
from guidefield.kernels.prove.pair_distance import squared_gap
from guidefield.kernels.prove.pairs import is_left_out
from guidefield.kernels.prove.placement import BodyPoses
from guidefield.kernels.prove.questions import AT_REST, IN_MOTION, is_judged
from guidefield.kernels.prove.tables import MovingRobot

SLACK = 1e-9
"""What boxes about spheres are wider by, for rounding, of a metre and of each metre that they are from the origin [m].
"""

TREE_STACK = 2048
"""Entries of the stack of boxes."""


@uncounted
def _add(
    moving: MovingRobot,
    row: int,
    o: int,
    reach: float,
    place: BodyPoses,
    pairs_out: Integers,
    start: int,
    capacity: int,
    count: int,
) -> int:
    """Add the pair of a moving body, by its row, and an obstacle if it may be within reach; return the new count."""
    mixed = row * moving.obstacles.roots.shape[0] + o
    pair = moving.pairs.own.shape[0] + mixed
    if squared_gap(moving, pair, place) > reach * reach or is_left_out(moving.pairs, mixed):
        return count
    if count < capacity:
        pairs_out[start + count] = pair
    return count + 1


@uncounted
def list_near(
    moving: MovingRobot,
    verdict: Floats,
    row: int,
    reach: float,
    mover_reach: Floats,
    place: BodyPoses,
    stack: Integers,
    pairs_out: Integers,
    start: int,
    capacity: int,
    count: int,
) -> int:
    """List the obstacles within reach of the centre of a body's bounding sphere.

    Args:
        moving: The robot and the obstacles.
        verdict: Kinds of pairs that count, shape (VERDICT,).
        row: The body, by its row of the moving ones.
        reach: The distance from the centre [m].
        mover_reach: How much farther each moving obstacle reaches, shape (v,) [m].
        place: The placement.
        stack: Scratch, shape (TREE_STACK, 2).
        pairs_out: Gets the pairs, shape (n,).
        start: Begin of the pairs in it.
        capacity: Maximum number of them.
        count: Number of pairs that it has.

    Returns:
        The new count; pairs beyond the capacity are counted only.
    """
    obstacles = moving.obstacles
    resting, in_motion = is_judged(verdict, AT_REST), is_judged(verdict, IN_MOTION)
    for k in range(obstacles.apart.shape[0]):
        o = obstacles.apart[k]
        mover = obstacles.movers[o]
        if (mover < 0 and resting) or (mover >= 0 and in_motion):
            count = _add(
                moving,
                row,
                o,
                reach + (mover_reach[mover] if mover >= 0 else 0.0),
                place,
                pairs_out,
                start,
                capacity,
                count,
            )
    if not resting:
        return count
    centre = place.centres[moving.pairs.moving[row]]
    x = reach + SLACK * (1.0 + abs(centre[0]))
    y = reach + SLACK * (1.0 + abs(centre[1]))
    z = reach + SLACK * (1.0 + abs(centre[2]))
    levels, nodes, waiting = obstacles.levels, obstacles.nodes, 0
    top = levels.shape[0] - 2
    for k in range(levels[top + 1] - levels[top]):
        stack[waiting, 0], stack[waiting, 1] = top, k
        waiting += 1
    while waiting > 0:
        waiting -= 1
        level, k = stack[waiting, 0], stack[waiting, 1]
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
            count = _add(moving, row, obstacles.order[k], reach, place, pairs_out, start, capacity, count)
            continue
        below = levels[level] - levels[level - 1]
        for child in range(obstacles.children * k, min(obstacles.children * (k + 1), below)):
            stack[waiting, 0], stack[waiting, 1] = level - 1, child
            waiting += 1
    return count


@uncounted
def nearest_within(moving: MovingRobot, pairs: Integers, count: int, place: BodyPoses, gaps_out: Floats) -> int:
    """Write the distance of each of some pairs by spheres and boxes; return the index of the smallest, -1 without one.

    Args:
        moving: The robot and the obstacles.
        pairs: Shape (n,).
        count: How many of them.
        place: The placement.
        gaps_out: Shape (n,) [m].
    """
    nearest = -1
    for index in range(count):
        row = (pairs[index] - moving.pairs.own.shape[0]) // moving.obstacles.roots.shape[0]
        radius = moving.robot.radii[moving.pairs.moving[row]]
        gaps_out[index] = math.sqrt(squared_gap(moving, pairs[index], place)) - radius
        if nearest < 0 or gaps_out[index] < gaps_out[nearest]:
            nearest = index
    return nearest
