"""Distances of pairs of bodies at a placement: of one pair by spheres, boxes and convex parts, and lists of near ones.

Proofs judge no other pairs than those listed (`search.py`, `samples.py`): a list may name a pair that is far, and must
not miss a near one. Each pair's next search begins with the axis and the leaves of its last one (`DistanceQuery.last`):
this changes time, and distances within `SLACK`. Distances from a moving obstacle are less by what is kept in addition,
as it may have left its motion.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from guidefield.kernels.collide.gjk import LEAF_A, LEAF_B, WORK, axis_in, bodies_distance, write_axis
from guidefield.kernels.collide.near_pairs import BoxedObstacles, find_boxes_near, is_left_out, squared_gap_to_box
from guidefield.kernels.jit.arrays import Floats, Integers
from guidefield.kernels.jit.decorators import counted, uncounted
from guidefield.kernels.prove.kept_distance import LOG_COUNT, LOG_PAIR, bodies_keep
from guidefield.kernels.prove.placement import NOW, BodyPoses, kept_from_mover, place_mover, seen_by_mover
from guidefield.kernels.prove.tables import (
    AT_REST,
    IN_MOTION,
    MovingRobot,
    RobotBodies,
    first_body,
    is_judged,
    obstacle_of,
)
from guidefield.kernels.simd.packing import pointers

LAST_AXIS, LAST_A, LAST_B, LAST = 0, 3, 4, 5
"""Columns of what is remembered of a pair: an axis, a leaf of each body, as in GJK's scratch; then their number."""

FIRST, SECOND, RESTING, POSES = range(4)
"""Rows of poses: of a robot body, of the other body, and the identity for what rests; then their number."""


class DistanceQuery(NamedTuple):
    """Scratch of distance queries."""

    last: Floats  # the axis and leaves with which the next search of each pair begins, shape (m, LAST)
    poses: Floats  # rotation and translation row by row, shape (POSES, 12) [m]
    work: Floats  # scratch, shape (WORK,)
    # slabs that close pairs, as `kept_distance` writes them; without capacity where none are asked for, (n,)
    log: Floats


@counted
def new_query(moving: MovingRobot, log: Floats) -> DistanceQuery:
    """Return scratch in which nothing is remembered, with a log of shape (n,)."""
    poses = np.zeros((POSES, 12))
    for k in (0, 5, 10):
        poses[RESTING, k] = 1.0
    pairs = moving.pairs.own.shape[0] + moving.pairs.moving.shape[0] * moving.obstacles.roots.shape[0]
    return DistanceQuery(np.zeros((pairs, LAST)), poses, np.zeros(WORK), log)


@uncounted
def squared_gap(moving: MovingRobot, pair: int, place: BodyPoses) -> float:
    """Return the squared distance from the centre of a pair's first sphere to that of the second, or to a box [m^2]."""
    obstacles, pairs = moving.obstacles, moving.pairs
    if pair < pairs.own.shape[0]:
        a, b = pairs.own[pair, 0], pairs.own[pair, 1]
        x, y, z = place.centres[a, 0], place.centres[a, 1], place.centres[a, 2]
        x, y, z = x - place.centres[b, 0], y - place.centres[b, 1], z - place.centres[b, 2]
        return float(x * x + y * y + z * z)
    a, b = first_body(pairs, obstacles, pair), obstacle_of(pairs, obstacles, pair)
    x, y, z = place.centres[a, 0], place.centres[a, 1], place.centres[a, 2]
    mover = obstacles.movers[b]
    if mover >= 0:
        place_mover(moving.movers, mover, place)
        x, y, z = seen_by_mover(place.mover_poses[mover], x, y, z)
    return squared_gap_to_box(obstacles.boxes, b, x, y, z)


@uncounted
def kept_in_addition(moving: MovingRobot, pair: int, place: BodyPoses) -> float:
    """Return the additional distance kept between a pair, as its obstacle may have left its motion [m]; else 0."""
    if pair < moving.pairs.own.shape[0]:
        return 0.0
    mover = moving.obstacles.movers[obstacle_of(moving.pairs, moving.obstacles, pair)]
    return kept_from_mover(moving.movers, mover, place.moment[NOW]) if mover >= 0 else 0.0


@uncounted
def least_distance(moving: MovingRobot, pair: int, place: BodyPoses) -> float:
    """Return a lower bound of a pair's distance at a placement, by spheres and boxes [m]."""
    radii, pairs = moving.robot.radii, moving.pairs
    radius = radii[first_body(pairs, moving.obstacles, pair)]
    if pair < pairs.own.shape[0]:
        radius += radii[pairs.own[pair, 1]]
    return float(math.sqrt(squared_gap(moving, pair, place)) - radius - kept_in_addition(moving, pair, place))


@uncounted
def pair_distance(moving: MovingRobot, pair: int, place: BodyPoses, most: float, query: DistanceQuery) -> float:
    """Return the distance of a pair at a placement, as `bodies_distance` does [m].

    Beyond `most` some lower bound of it.
    """
    robot, obstacles, pairs = moving.robot, moving.obstacles, moving.pairs
    root, scratch = robot.roots[first_body(pairs, obstacles, pair)], _begin_query(moving, pair, place, query)
    own, pose_a, pose_b = pointers(robot.parts), pointers(query.poses[FIRST]), pointers(query.poses[SECOND])
    more = kept_in_addition(moving, pair, place)
    if pair < pairs.own.shape[0]:
        found = bodies_distance(own, root, pose_a, own, robot.roots[pairs.own[pair, 1]], pose_b, most, scratch)
    else:
        other, scene = obstacles.roots[obstacle_of(pairs, obstacles, pair)], pointers(obstacles.parts)
        found = bodies_distance(own, root, pose_a, scene, other, pose_b, most + more, scratch)
    _remember(pair, query)
    return float(found - more)


@uncounted
def pair_keeps(
    moving: MovingRobot,
    pair: int,
    place: BodyPoses,
    known: Floats,
    share: float,
    asked: float,
    bent: float,
    query: DistanceQuery,
) -> float:
    """Return infinity if a pair keeps a distance about a placement while its bodies move straight, as `bodies_keep`.

    `known` begins with the twists of its bodies, of which they move by the largest share `share`, there and back.
    `asked` is the distance, above 0 [m], of which `bent` is how far points may be from where the twists bring them.
    """
    robot, obstacles, pairs = moving.robot, moving.obstacles, moving.pairs
    root, scratch = robot.roots[first_body(pairs, obstacles, pair)], _begin_query(moving, pair, place, query)
    own, pose_a, pose_b = pointers(robot.parts), pointers(query.poses[FIRST]), pointers(query.poses[SECOND])
    twists, log, begun = pointers(known), pointers(query.log), query.log[LOG_COUNT]
    more = kept_in_addition(moving, pair, place)
    log[LOG_PAIR] = float(pair)
    if pair < pairs.own.shape[0]:
        other = robot.roots[pairs.own[pair, 1]]
        found = bodies_keep(own, root, pose_a, own, other, pose_b, twists, share, asked, bent, scratch, log)
    else:
        other, scene = obstacles.roots[obstacle_of(pairs, obstacles, pair)], pointers(obstacles.parts)
        found = bodies_keep(own, root, pose_a, scene, other, pose_b, twists, share, asked + more, bent, scratch, log)
    if found < np.inf:  # the results of some of its nodes count no longer
        log[LOG_COUNT] = begun
    _remember(pair, query)
    return float(found - more)


@uncounted
def _begin_query(moving: MovingRobot, pair: int, place: BodyPoses, query: DistanceQuery) -> Floats:
    """Return the scratch of GJK with what is remembered of a pair, whose bodies are placed."""
    robot, pairs, last = moving.robot, moving.pairs, query.last[pair]
    scratch: Floats = pointers(query.work)
    write_axis(scratch, last[LAST_AXIS], last[LAST_AXIS + 1], last[LAST_AXIS + 2])
    scratch[LEAF_A], scratch[LEAF_B] = last[LAST_A], last[LAST_B]
    _write_pose(robot, robot.parent_joints[first_body(pairs, moving.obstacles, pair)], place, query.poses[FIRST])
    if pair < pairs.own.shape[0]:
        _write_pose(robot, robot.parent_joints[pairs.own[pair, 1]], place, query.poses[SECOND])
        return scratch
    mover = moving.obstacles.movers[obstacle_of(pairs, moving.obstacles, pair)]
    source = query.poses[RESTING]
    if mover >= 0:
        place_mover(moving.movers, mover, place)
        if moving.movers.endless[mover] == 1:  # its plane is known where it is at first: the body is brought there
            _bring_back(place.mover_poses[mover], query.poses[FIRST])
        else:
            source = place.mover_poses[mover]
    anchor = moving.obstacles.anchor
    for row in range(3):
        moved = source[4 * row + 3]
        for k in range(3):
            query.poses[SECOND, 4 * row + k] = source[4 * row + k]
            moved += source[4 * row + k] * anchor[k]
        query.poses[SECOND, 4 * row + 3] = moved
    return scratch


@uncounted
def _bring_back(mover: Floats, pose: Floats) -> None:
    """Replace a body's pose (12,) by that seen from a moving obstacle, by the obstacle's pose (12,)."""
    x, y, z = seen_by_mover(mover, pose[3], pose[7], pose[11])
    for column in range(3):
        u, v, w = pose[column], pose[4 + column], pose[8 + column]
        for row in range(3):
            pose[4 * row + column] = mover[row] * u + mover[4 + row] * v + mover[8 + row] * w
    pose[3], pose[7], pose[11] = x, y, z


@uncounted
def _remember(pair: int, query: DistanceQuery) -> None:
    last, scratch = query.last[pair], pointers(query.work)
    last[LAST_AXIS], last[LAST_AXIS + 1], last[LAST_AXIS + 2] = axis_in(scratch)
    last[LAST_A], last[LAST_B] = scratch[LEAF_A], scratch[LEAF_B]


@uncounted
def _write_pose(robot: RobotBodies, joint: int, place: BodyPoses, pose_out: Floats) -> None:
    """Write the pose of the parts that a joint carries, row by row, shape (12,)."""
    for r in range(3):
        for c in range(4):
            pose_out[4 * r + c] = place.poses[joint, r, c]
        if joint == 0:
            pose_out[4 * r + 3] += robot.anchor[r]


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
