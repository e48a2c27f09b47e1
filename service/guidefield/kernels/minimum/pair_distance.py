"""Distance of a pair of bodies at a place: at least, by balls and boxes, and by their convex parts."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from guidefield.kernels.collide.gjk_scratch import LEAF_A, LEAF_B, WORK, axis_in, write_axis
from guidefield.kernels.jit.no_refcount import counted, uncounted
from guidefield.kernels.jit.signatures import Floats
from guidefield.kernels.minimum.body_distance import bodies_distance
from guidefield.kernels.minimum.places import Places
from guidefield.kernels.minimum.tables import MovingRobot
from guidefield.kernels.simd.packing import pointers

LAST_AXIS, LAST_A, LAST_B, LAST = 0, 3, 4, 5
"""Numbers that are remembered of a pair: an axis, a leaf of each body, as in GJK's scratch; then how many there are."""

FIRST, SECOND, AT_REST, POSES = range(4)
"""Rows of poses: of a body of the robot, of another one, and of what rests: the identity; then how many there are."""


class Ask(NamedTuple):
    """What distances are asked with.

    Attributes:
        last: What is remembered of each pair: where its next search begins, shape (m, LAST).
        poses: Rotation and translation row by row, shape (POSES, 12) [m].
        work: Scratch, shape (WORK,).
    """

    last: Floats
    poses: Floats
    work: Floats


@counted
def new_ask(moving: MovingRobot) -> Ask:
    """Nothing is remembered yet."""
    poses = np.zeros((POSES, 12))
    for k in (0, 5, 10):
        poses[AT_REST, k] = 1.0
    return Ask(np.zeros((moving.pairs.first.shape[0], LAST)), poses, np.zeros(WORK))


@uncounted
def least_distance(moving: MovingRobot, pair: int, s: int, places: Places) -> float:
    """What a pair keeps at least at a place, row s, by the balls about bodies and the boxes about obstacles [m]."""
    robot, obstacles, pairs = moving.robot, moving.obstacles, moving.pairs
    a, b = pairs.first[pair], pairs.second[pair]
    x, y, z = places.centres[s, a, 0], places.centres[s, a, 1], places.centres[s, a, 2]
    if pair < pairs.first_by.shape[0]:
        x, y, z = x - places.centres[s, b, 0], y - places.centres[s, b, 1], z - places.centres[s, b, 2]
        return math.sqrt(x * x + y * y + z * z) - float(robot.radii[a] + robot.radii[b])
    square = 0.0
    for k in range(3):
        along = obstacles.axes[b, 3 * k] * x + obstacles.axes[b, 3 * k + 1] * y + obstacles.axes[b, 3 * k + 2] * z
        beyond = max(abs(along - obstacles.centres[b, k]) - obstacles.halves[b, k], 0.0)
        square += beyond * beyond
    return math.sqrt(square) - float(robot.radii[a])


@uncounted
def pair_distance(moving: MovingRobot, pair: int, s: int, places: Places, most: float, ask: Ask) -> float:
    """The distance of a pair at a place.

    Args:
        moving: The robot and the pairs.
        pair: Which of them.
        s: Row of the place.
        places: The places.
        most: If they are farther apart than this, some bound of their distance that is no less than it is enough [m].
        ask: Where the search begins, and its scratch; changed.

    Returns:
        See `bodies_distance` [m].
    """
    robot, obstacles, pairs = moving.robot, moving.obstacles, moving.pairs
    a, b = pairs.first[pair], pairs.second[pair]
    scratch, poses, last = pointers(ask.work), ask.poses, ask.last[pair]
    write_axis(scratch, last[LAST_AXIS], last[LAST_AXIS + 1], last[LAST_AXIS + 2])
    scratch[LEAF_A], scratch[LEAF_B] = last[LAST_A], last[LAST_B]
    _write_pose(places.poses[s, robot.carriers[a]], poses[FIRST])
    own, root, pose_a = pointers(robot.parts), robot.roots[a], pointers(poses[FIRST])
    if pair < pairs.first_by.shape[0]:
        _write_pose(places.poses[s, robot.carriers[b]], poses[SECOND])
        found = bodies_distance(own, root, pose_a, own, robot.roots[b], pointers(poses[SECOND]), most, scratch)
    else:
        scene, rests = pointers(obstacles.parts), pointers(poses[AT_REST])
        found = bodies_distance(own, root, pose_a, scene, obstacles.roots[b], rests, most, scratch)
    last[LAST_AXIS], last[LAST_AXIS + 1], last[LAST_AXIS + 2] = axis_in(scratch)
    last[LAST_A], last[LAST_B] = scratch[LEAF_A], scratch[LEAF_B]
    return float(found)


@uncounted
def _write_pose(placement: Floats, pose_out: Floats) -> None:
    for r in range(3):
        for c in range(4):
            pose_out[4 * r + c] = placement[r, c]
