"""Pairs that can come within a distance in a segment: by bounding spheres, boxes and a tree of boxes.

Proofs judge no others (`search.py`, `samples.py`): a list may name a pair that is far, and must not miss a near one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from guidefield.kernels.collide.near_pairs import BoxedObstacles, find_boxes_near, is_left_out
from guidefield.kernels.jit.arrays import Floats, Integers
from guidefield.kernels.jit.decorators import counted, uncounted
from guidefield.kernels.prove.pair_distance import least_distance, squared_gap
from guidefield.kernels.prove.placement import BodyPoses
from guidefield.kernels.prove.tables import AT_REST, IN_MOTION, MovingRobot, is_judged


class NearBoxes(NamedTuple):
    """Scratch to find boxes near a place."""

    box: Floats  # corners of a box, shape (2, 3) [m]
    stack: Integers  # of boxes of the tree, shape (children * levels, 2)
    met: Integers  # obstacles, shape (o,)


@counted
def new_near_boxes(boxes: BoxedObstacles) -> NearBoxes:
    """Return the scratch for a tree of boxes."""
    stack = np.empty((boxes.children * boxes.levels.shape[0], 2), np.int64)
    return NearBoxes(np.empty((2, 3)), stack, np.empty(boxes.axes.shape[0], np.int64))


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
    if squared_gap(moving, pair, place) > reach * reach or is_left_out(moving.pairs.left_out, mixed):
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
    near: NearBoxes,
    pairs_out: Integers,
    start: int,
    capacity: int,
    count: int,
) -> int:
    """List the obstacles within reach of the centre of a body's bounding sphere, from `start` on; return the new count.

    The body is given by its row of the moving ones, kinds of pairs by a verdict (VERDICT,), `mover_reach` (v,) is how
    much farther each moving obstacle reaches [m]; pairs beyond the capacity of `pairs_out` (n,) are counted only.
    """
    obstacles, boxes = moving.obstacles, moving.obstacles.boxes
    resting, in_motion = is_judged(verdict, AT_REST), is_judged(verdict, IN_MOTION)
    for k in range(boxes.apart.shape[0]):
        o = boxes.apart[k]
        mover = obstacles.movers[o]
        if (mover < 0 and resting) or (mover >= 0 and in_motion):
            within = reach + (mover_reach[mover] if mover >= 0 else 0.0)
            count = _add(moving, row, o, within, place, pairs_out, start, capacity, count)
    if resting:
        centre = place.centres[moving.pairs.moving[row]]
        for k in range(find_boxes_near(boxes, centre, reach, near.box, near.stack, near.met)):
            count = _add(moving, row, near.met[k], reach, place, pairs_out, start, capacity, count)
    return count


@uncounted
def nearest_within(moving: MovingRobot, pairs: Integers, count: int, place: BodyPoses, gaps_out: Floats) -> int:
    """Write the distances (n,) of pairs by spheres and boxes [m]; return the index of the smallest, -1 without one."""
    nearest = -1
    for index in range(count):
        gaps_out[index] = least_distance(moving, pairs[index], place)
        if nearest < 0 or gaps_out[index] < gaps_out[nearest]:
            nearest = index
    return nearest
