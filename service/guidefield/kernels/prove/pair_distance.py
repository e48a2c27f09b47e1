"""Distance of a pair of bodies at a place: at least, by balls and boxes, by their convex parts, and for a while."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from guidefield.kernels.collide.gjk_scratch import LEAF_A, LEAF_B, WORK, axis_in, write_axis
from guidefield.kernels.jit.no_refcount import counted, uncounted
from guidefield.kernels.jit.signatures import Floats
from guidefield.kernels.prove.body_distance import bodies_distance
from guidefield.kernels.prove.kept_distance import bodies_keep
from guidefield.kernels.prove.places import Place
from guidefield.kernels.prove.tables import MovingRobot
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
def squared_gap(moving: MovingRobot, pair: int, place: Place) -> float:
    """How far the centre of a pair's first ball is at a place from that of the second, or from a box, squared [m^2]."""
    obstacles, pairs = moving.obstacles, moving.pairs
    a, b = pairs.first[pair], pairs.second[pair]
    x, y, z = place.centres[a, 0], place.centres[a, 1], place.centres[a, 2]
    if pair < pairs.first_by.shape[0]:
        x, y, z = x - place.centres[b, 0], y - place.centres[b, 1], z - place.centres[b, 2]
        return float(x * x + y * y + z * z)
    square = 0.0
    for k in range(3):
        along = obstacles.axes[b, 3 * k] * x + obstacles.axes[b, 3 * k + 1] * y + obstacles.axes[b, 3 * k + 2] * z
        beyond = max(abs(along - obstacles.centres[b, k]) - obstacles.halves[b, k], 0.0)
        square += beyond * beyond
    return square


@uncounted
def least_distance(moving: MovingRobot, pair: int, place: Place) -> float:
    """What a pair keeps at least at a place, by the balls about bodies and the boxes about obstacles [m]."""
    radii, pairs = moving.robot.radii, moving.pairs
    radius = radii[pairs.first[pair]]
    if pair < pairs.first_by.shape[0]:
        radius += radii[pairs.second[pair]]
    return float(math.sqrt(squared_gap(moving, pair, place)) - radius)


@uncounted
def pair_distance(moving: MovingRobot, pair: int, place: Place, most: float, ask: Ask) -> float:
    """The distance of a pair at a place.

    Args:
        moving: The robot and the pairs.
        pair: Which of them.
        place: The place.
        most: If they are farther apart than this, some bound of their distance that is no less than it is enough [m].
        ask: Where the search begins, and its scratch; changed.

    Returns:
        See `bodies_distance` [m].
    """
    robot, obstacles, second = moving.robot, moving.obstacles, moving.pairs.second[pair]
    own, root, scratch = pointers(robot.parts), robot.roots[moving.pairs.first[pair]], _begun(moving, pair, place, ask)
    pose_a, pose_b, rests = pointers(ask.poses[FIRST]), pointers(ask.poses[SECOND]), pointers(ask.poses[AT_REST])
    if pair < moving.pairs.first_by.shape[0]:
        found = bodies_distance(own, root, pose_a, own, robot.roots[second], pose_b, most, scratch)
    else:
        scene = pointers(obstacles.parts)
        found = bodies_distance(own, root, pose_a, scene, obstacles.roots[second], rests, most, scratch)
    _remember(pair, ask)
    return float(found)


@uncounted
def pair_keeps(
    moving: MovingRobot, pair: int, place: Place, known: Floats, share: float, asked: float, bent: float, ask: Ask
) -> float:
    """Whether a pair would keep a distance about a place if its bodies moved straight by shares of their twists.

    Args:
        moving: The robot and the pairs.
        pair: Which of them.
        place: The place.
        known: What is known of its mover; it begins with the twists of its bodies.
        share: How much of these at most, there and back.
        asked: The distance, above 0 [m]; how far points may be from where the twists bring them is added to it.
        bent: How much of it that is [m].
        ask: Where the search begins, and its scratch; changed.

    Returns:
        See `bodies_keep`.
    """
    robot, obstacles, second = moving.robot, moving.obstacles, moving.pairs.second[pair]
    own, root, scratch = pointers(robot.parts), robot.roots[moving.pairs.first[pair]], _begun(moving, pair, place, ask)
    pose_a, pose_b, rests = pointers(ask.poses[FIRST]), pointers(ask.poses[SECOND]), pointers(ask.poses[AT_REST])
    twists = pointers(known)
    if pair < moving.pairs.first_by.shape[0]:
        found = bodies_keep(own, root, pose_a, own, robot.roots[second], pose_b, twists, share, asked, bent, scratch)
    else:
        scene = pointers(obstacles.parts)
        found = bodies_keep(
            own, root, pose_a, scene, obstacles.roots[second], rests, twists, share, asked, bent, scratch
        )
    _remember(pair, ask)
    return float(found)


@uncounted
def _begun(moving: MovingRobot, pair: int, place: Place, ask: Ask) -> Floats:
    """The scratch of GJK with what is remembered of a pair, whose bodies are placed."""
    robot, pairs, last = moving.robot, moving.pairs, ask.last[pair]
    scratch: Floats = pointers(ask.work)
    write_axis(scratch, last[LAST_AXIS], last[LAST_AXIS + 1], last[LAST_AXIS + 2])
    scratch[LEAF_A], scratch[LEAF_B] = last[LAST_A], last[LAST_B]
    _write_pose(place.poses[robot.carriers[pairs.first[pair]]], ask.poses[FIRST])
    if pair < pairs.first_by.shape[0]:
        _write_pose(place.poses[robot.carriers[pairs.second[pair]]], ask.poses[SECOND])
    return scratch


@uncounted
def _remember(pair: int, ask: Ask) -> None:
    """Remember of a pair where its next search begins."""
    last, scratch = ask.last[pair], pointers(ask.work)
    last[LAST_AXIS], last[LAST_AXIS + 1], last[LAST_AXIS + 2] = axis_in(scratch)
    last[LAST_A], last[LAST_B] = scratch[LEAF_A], scratch[LEAF_B]


@uncounted
def _write_pose(placement: Floats, pose_out: Floats) -> None:
    for r in range(3):
        for c in range(4):
            pose_out[4 * r + c] = placement[r, c]
