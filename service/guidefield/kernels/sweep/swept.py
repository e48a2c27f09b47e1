"""A test that capsules about links keep from obstacles and each other along a straight motion in local coordinates.

A yes is rigorous: parts of the motion are judged at their middles, where every capsule has to keep more than it can
lose within the part: the smaller of the sum of what the joints do (collision/motion_bound.py has its proof) and of
speed at the middle and largest acceleration. A no only says that capsules can't tell.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types

from guidefield.kernels.distance.distance import TABLES, DistanceTables, bodies_near, nearest_body
from guidefield.kernels.jit.no_refcount import uncounted
from guidefield.kernels.jit.signatures import SCALAR, VECTOR, Floats, Integers, compiled
from guidefield.kernels.kinematics.chart import configuration
from guidefield.kernels.kinematics.forward_kinematics import joint_placements
from guidefield.kernels.sweep.swept_bounds import (
    RADIUS,
    SWEPT,
    SweptRobot,
    capsule_accelerations,
    capsule_ends,
    capsule_speeds,
    changing,
    joint_shares,
    largest_move,
    spreads,
)

_DEEPEST = 14
"""A motion is halved no more often than this."""

_STACK = 64


@uncounted
def _segment_distance(ends: Floats, a: int, b: int) -> float:
    """Distance of the axes of two capsules (C. Ericson, Real-Time Collision Detection, 2005, section 5.1.9)."""
    d1x, d1y, d1z = ends[a, 3] - ends[a, 0], ends[a, 4] - ends[a, 1], ends[a, 5] - ends[a, 2]
    d2x, d2y, d2z = ends[b, 3] - ends[b, 0], ends[b, 4] - ends[b, 1], ends[b, 5] - ends[b, 2]
    rx, ry, rz = ends[a, 0] - ends[b, 0], ends[a, 1] - ends[b, 1], ends[a, 2] - ends[b, 2]
    aa, ee = d1x * d1x + d1y * d1y + d1z * d1z, d2x * d2x + d2y * d2y + d2z * d2z
    f = d2x * rx + d2y * ry + d2z * rz
    c = d1x * rx + d1y * ry + d1z * rz
    bb = d1x * d2x + d1y * d2y + d1z * d2z
    aa, ee = max(aa, 1e-30), max(ee, 1e-30)
    denominator = aa * ee - bb * bb
    s = min(max((bb * f - c * ee) / denominator, 0.0), 1.0) if denominator > 1e-12 * aa * ee else 0.0
    t = (bb * s + f) / ee
    if t < 0.0:
        t, s = 0.0, min(max(-c / aa, 0.0), 1.0)
    elif t > 1.0:
        t, s = 1.0, min(max((bb - c) / aa, 0.0), 1.0)
    x, y, z = rx + s * d1x - t * d2x, ry + s * d1y - t * d2y, rz + s * d1z - t * d2z
    return math.sqrt(x * x + y * y + z * z)


@uncounted
def _keeps(ends: Floats, c: int, keep: float, tables: DistanceTables, candidates: Integers, stack: Floats) -> bool:
    """Tell if the axis of capsule c is farther than `keep` from all obstacles: halved until every part tells."""
    dx, dy, dz = ends[c, 3] - ends[c, 0], ends[c, 4] - ends[c, 1], ends[c, 5] - ends[c, 2]
    length = math.sqrt(dx * dx + dy * dy + dz * dz)
    mx, my, mz = ends[c, 0] + 0.5 * dx, ends[c, 1] + 0.5 * dy, ends[c, 2] + 0.5 * dz
    count = bodies_near(mx, my, mz, 0.5 * length + keep, tables, candidates)
    if count == 0:
        return True
    stack[0, 0], stack[0, 1] = 0.0, 1.0
    top = 1
    while top > 0:
        top -= 1
        s0, s1 = stack[top, 0], stack[top, 1]
        s, half = 0.5 * (s0 + s1), 0.5 * (s1 - s0) * length
        x, y, z = ends[c, 0] + s * dx, ends[c, 1] + s * dy, ends[c, 2] + s * dz
        d = nearest_body(x, y, z, candidates, count, tables, half + keep)[0]
        if d > half + keep:
            continue
        if d <= keep or half < 0.02 * keep:
            return False
        stack[top, 0], stack[top, 1] = s0, s
        stack[top + 1, 0], stack[top + 1, 1] = s, s1
        top += 2
    return True


@uncounted
def _far(robot: SweptRobot, item: int, balls: Floats, bound: float, self_margin: float) -> bool:
    """Tell if a pair of capsules keeps more than its margin and a bound, as the balls about them tell."""
    count = robot.capsules.shape[0]
    if item < count:
        return False
    a, b = robot.own[item - count, 0], robot.own[item - count, 1]
    x, y, z = balls[a, 0] - balls[b, 0], balls[a, 1] - balls[b, 1], balls[a, 2] - balls[b, 2]
    return bool(x * x + y * y + z * z > (balls[a, 3] + balls[b, 3] + self_margin + bound) ** 2)


@uncounted
def _item_apart(
    robot: SweptRobot, tables: DistanceTables, item: int, ends: Floats, bound: float, margin: float,
    self_margin: float, candidates: Integers, parts: Floats,
) -> bool:  # fmt: skip
    """Tell if a capsule, or a pair of them, keeps more than its margin and a bound."""
    count = robot.capsules.shape[0]
    if item < count:
        keep = robot.capsules[item, RADIUS] + margin + bound
        return bool(_keeps(ends, item, keep, tables, candidates, parts))
    a, b = robot.own[item - count, 0], robot.own[item - count, 1]
    return bool(
        _segment_distance(ends, a, b) > robot.capsules[a, RADIUS] + robot.capsules[b, RADIUS] + self_margin + bound
    )


@uncounted
def _at(robot: SweptRobot, z: Floats, q: Floats, world: Floats, ends: Floats, balls: Floats) -> None:
    """Place the capsules at chart coordinates, and the balls about them: their middles, and their radii."""
    joints = robot.joints
    configuration(joints, z, robot.origin, q)
    joint_placements(joints, q, world)
    capsule_ends(robot, world, ends)
    for c in range(robot.capsules.shape[0]):
        square = 0.0
        for k in range(3):
            balls[c, k] = 0.5 * (ends[c, k] + ends[c, 3 + k])
            square += (ends[c, 3 + k] - ends[c, k]) ** 2
        balls[c, 3] = 0.5 * math.sqrt(square) + robot.capsules[c, RADIUS]


@compiled(types.boolean(SWEPT, TABLES, VECTOR, VECTOR, SCALAR, SCALAR, SCALAR))
def motion_apart(
    robot: SweptRobot, tables: DistanceTables, z0: Floats, z1: Floats, margin: float, self_margin: float, floor: float
) -> bool:
    """Tell if the capsules stay apart all along the straight motion from z0 to z1.

    Args:
        robot: The capsules.
        tables: The obstacles.
        z0: Start in the chart of the robot's model, shape (nv,) [rad or m].
        z1: End, shape (nv,).
        margin: What capsules keep from obstacles at least [m].
        self_margin: What they keep from each other at least [m].
        floor: A part of the motion that moves a capsule by no more than this is not halved any more [m].
    """
    n, count = robot.joints.parents.shape[0], robot.capsules.shape[0]
    items = count + robot.own.shape[0]
    world, ends, balls = np.empty((n, 3, 4)), np.empty((count, 6)), np.empty((count, 4))
    shares, chords, moving = np.empty((count, n)), np.empty(n), np.empty(n, np.int64)
    subspaces, twists = np.empty((z0.shape[0], 6)), np.empty((n, 6))
    turns, slides, z, dz = np.zeros(n), np.zeros((n, 2)), z1.copy(), z1 - z0
    accelerations, speeds = np.empty(count), np.empty(count)
    q = np.empty(robot.origin.shape[0])
    candidates = np.empty(tables.kinds.shape[0], np.int64)
    parts, waiting = np.empty((_STACK, 2)), np.empty((_STACK, 2))
    depths, counts = np.zeros(_STACK, np.int64), np.zeros(_DEEPEST + 2, np.int64)
    pending = np.empty((_DEEPEST + 2, items), np.int64)
    # the end first: most motions that are refused end in contact
    _at(robot, z, q, world, ends, balls)
    for item in range(items):
        judged = robot.carriers[item] > 0 if item < count else not _far(robot, item, balls, 0.0, self_margin)
        if judged and not _item_apart(robot, tables, item, ends, 0.0, margin, self_margin, candidates, parts):
            return False
    spreads(robot, z0, z1, turns, slides)
    capsule_accelerations(robot, turns, slides, accelerations)
    counts[0] = changing(robot, turns, slides, moving, pending[0])
    waiting[0, 0], waiting[0, 1] = 0.0, 1.0
    top = 1 if counts[0] > 0 else 0
    while top > 0:
        top -= 1
        t0, t1, depth = waiting[top, 0], waiting[top, 1], depths[top]
        t, half = 0.5 * (t0 + t1), 0.5 * (t1 - t0)
        for k in range(z0.shape[0]):
            z[k] = z0[k] + t * dz[k]
        _at(robot, z, q, world, ends, balls)
        joint_shares(robot, world, ends, turns, slides, half, chords, shares)
        capsule_speeds(robot, world, z, q, dz, ends, subspaces, twists, speeds)
        left = 0
        for k in range(counts[depth]):
            item = pending[depth, k]
            bound = largest_move(robot, item, shares, speeds, accelerations, half)
            if _far(robot, item, balls, bound, self_margin):
                continue
            if not _item_apart(robot, tables, item, ends, bound, margin, self_margin, candidates, parts):
                if bound <= floor or depth == _DEEPEST:
                    return False
                pending[depth + 1, left] = item
                left += 1
        if left > 0:
            # only what could not be told apart is looked at again; the second half waits for the first to be done
            counts[depth + 1] = left
            waiting[top, 0], waiting[top, 1], depths[top] = t, t1, depth + 1
            waiting[top + 1, 0], waiting[top + 1, 1], depths[top + 1] = t0, t, depth + 1
            top += 2
    return True
