"""A test that capsules which a robot's joints carry stay apart along a straight motion in local coordinates.

Two bounds on their motion, both rigorous: the sum of what the joints do (`MotionBound` of collision/bodies.py has its
proof), and a capsule's speed at the middle of the motion with its largest acceleration, which counts what joints undo
of each other. Minimizers and `planner/guide/guided_path.py` rely on a yes, which is certain; a no may be a doubt.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from guidefield.kernels.distance.distance import DistanceTables, bodies_near, nearest_body
from guidefield.kernels.jit.arrays import Floats, IndexRows, Indices, Integers, Row, Rows, numba_type
from guidefield.kernels.jit.decorators import kernel, uncounted
from guidefield.kernels.kinematics.forward_kinematics import (
    CONTINUOUS,
    FLOATING,
    PLANAR,
    PRISMATIC,
    REVOLUTE,
    JointTable,
    configuration,
    joint_placements,
    motion_subspaces,
    subspaces_by_local,
)
from guidefield.kernels.kinematics.poses import moved_by, turned_by

FIRST_END, SECOND_END, RADIUS, CAPSULE = 0, 3, 6, 7
"""Columns of a capsule: the ends of its axis (3 each) and its radius [m]; then how many columns there are."""


class SweptRobot(NamedTuple):
    """A robot as capsules that its joints carry."""

    joints: JointTable  # the joints of its model
    origin: Row  # (nq,) configuration from which rotation vectors start
    capsules: Rows  # (c, CAPSULE) ends and radius in the frame of their joint [m]
    parent_joints: Indices  # (c,) the joint of each; 0 stands still
    own: IndexRows  # (k, 2) capsules that must not touch each other
    # (k, 2) for each of these two the joint nearest to the root that moves it and not the other; 0 if none does
    apart: IndexRows


SWEPT = numba_type(SweptRobot)


@uncounted
def spreads(robot: SweptRobot, z0: Floats, z1: Floats, turns_out: Floats, slides_out: Floats) -> None:
    """Write how far each joint turns (n,) [rad], slides, and is out at most (n, 2) [m], from z0 to z1 (nv,)."""
    for i in range(1, robot.joints.parents.shape[0]):
        at, kind = robot.joints.idx_v[i], robot.joints.kinds[i]
        slid = 3 if kind == FLOATING else 2 if kind == PLANAR else 1 if kind == PRISMATIC else 0
        first, last, change, turn = 0.0, 0.0, 0.0, 0.0
        for k in range(at, at + robot.joints.nv[i]):
            square = (z1[k] - z0[k]) ** 2
            if k < at + slid:
                first, last, change = first + z0[k] * z0[k], last + z1[k] * z1[k], change + square
            else:
                turn += square
        turns_out[i] = math.sqrt(turn)
        slides_out[i, 0], slides_out[i, 1] = math.sqrt(change), math.sqrt(max(first, last))


@uncounted
def _lever(robot: SweptRobot, joint: int, world: Floats, end: Floats) -> float:
    """Distance of a world point (3,) from a joint's axis, or from its centre where it has no one axis."""
    T = world[joint]
    dx, dy, dz = end[0] - T[0, 3], end[1] - T[1, 3], end[2] - T[2, 3]
    square = dx * dx + dy * dy + dz * dz
    kind = robot.joints.kinds[joint]
    if kind in (REVOLUTE, CONTINUOUS, PLANAR):
        x, y, z = robot.joints.axes[joint, 0], robot.joints.axes[joint, 1], robot.joints.axes[joint, 2]
        if kind == PLANAR:
            x, y, z = 0.0, 0.0, 1.0
        u, v, w = turned_by(T, x, y, z)
        x, y, z = dy * w - dz * v, dz * u - dx * w, dx * v - dy * u
        square = x * x + y * y + z * z
    return math.sqrt(square)


@uncounted
def capsule_ends(robot: SweptRobot, world: Floats, ends_out: Floats) -> None:
    """Write the ends (c, 6) of the capsules' axes in the world, by placements of joints (n, 3, 4) [m]."""
    for c in range(robot.capsules.shape[0]):
        T = world[robot.parent_joints[c]]
        for e in (FIRST_END, SECOND_END):
            x, y, z = robot.capsules[c, e], robot.capsules[c, e + 1], robot.capsules[c, e + 2]
            ends_out[c, e], ends_out[c, e + 1], ends_out[c, e + 2] = moved_by(T, x, y, z)


@uncounted
def joint_shares(
    robot: SweptRobot,
    world: Floats,
    ends: Floats,
    turns: Floats,
    slides: Floats,
    half: float,
    chords: Floats,
    shares_out: Floats,
) -> None:
    """Write how far each joint up to the root moves each capsule at most within a part of the motion, (c, n) [m].

    Placements (n, 3, 4) and `ends` (c, 6) are those at the middle of the part, `half` of the motion away from its ends;
    turns (n,) and slides (n, 2) are those of `spreads`; scratch (n,).
    """
    parents = robot.joints.parents
    for j in range(1, parents.shape[0]):
        chords[j] = 2.0 * math.sin(0.5 * min(half * turns[j], math.pi))
    for c in range(robot.capsules.shape[0]):
        together, j = 0.0, robot.parent_joints[c]
        while j > 0:
            if turns[j] > 0.0 or slides[j, 0] > 0.0:
                lever = max(_lever(robot, j, world, ends[c, :3]), _lever(robot, j, world, ends[c, 3:6]))
                together += half * slides[j, 0] + chords[j] * (lever + robot.capsules[c, RADIUS])
            shares_out[c, j] = together
            j = parents[j]
        shares_out[c, 0] = together


@uncounted
def capsule_accelerations(robot: SweptRobot, turns: Floats, slides: Floats, out: Floats) -> None:
    """Bound the acceleration (c,) of each capsule's points along the motion, time running from 0 to 1 [m].

    Up from the capsule's joint: a joint with p + R X before it, |p'| = s constant, turning at w at most, makes of
    bounds r, v, a on X, X', X'' the bounds |p| + r, s + w r + v and 3/2 w^2 r + 2 w v + a. Its angular velocity J_r(z)
    z' changes by w^2 / 2 at most, as J_r(z) is the mean of exp(-u [z]) over u from 0 to 1; about one axis it doesn't
    change. The length |p| of slides is at most what they are at the end they are longer at. Turns (n,) and slides (n,
    2) are those of `spreads`.
    """
    for c in range(robot.capsules.shape[0]):
        row = robot.capsules[c]
        x, y, z = row[FIRST_END], row[FIRST_END + 1], row[FIRST_END + 2]
        u, v, w = row[SECOND_END], row[SECOND_END + 1], row[SECOND_END + 2]
        r = row[RADIUS] + math.sqrt(max(x * x + y * y + z * z, u * u + v * v + w * w))
        v, a = 0.0, 0.0
        j = robot.parent_joints[c]
        while j > 0:
            w, kind = turns[j], robot.joints.kinds[j]
            change = 1.0 if kind in (REVOLUTE, CONTINUOUS, PLANAR) else 1.5
            a = change * w * w * r + 2.0 * w * v + a
            v = slides[j, 0] + w * r + v
            T = robot.joints.placements[j]
            r += slides[j, 1] + math.sqrt(T[0, 3] ** 2 + T[1, 3] ** 2 + T[2, 3] ** 2)
            j = robot.joints.parents[j]
        out[c] = a


@uncounted
def capsule_speeds(
    robot: SweptRobot, world: Floats, z: Floats, q: Floats, dz: Floats, ends: Floats, subspaces: Floats, twists: Floats,
    speeds_out: Floats,
) -> None:  # fmt: skip
    """Write the speed (c,) of the fastest point of each capsule at a configuration, time running from 0 to 1 [m].

    At z (nv,), q (nq,), placements (n, 3, 4) and `ends` (c, 6), with dz (nv,) the whole motion; scratch (nv, 6), (n,
    6).
    """
    joints = robot.joints
    motion_subspaces(joints, world, subspaces)
    subspaces_by_local(joints, z, q, subspaces)
    twists[0, :] = 0.0
    for i in range(1, joints.parents.shape[0]):
        for k in range(6):
            value = twists[joints.parents[i], k]
            for r in range(joints.idx_v[i], joints.idx_v[i] + joints.nv[i]):
                value += subspaces[r, k] * dz[r]
            twists[i, k] = value
    for c in range(robot.capsules.shape[0]):
        t = twists[robot.parent_joints[c]]
        fastest = 0.0
        for e in range(2):
            x, y, u = ends[c, 3 * e], ends[c, 3 * e + 1], ends[c, 3 * e + 2]
            vx, vy, vz = t[0] + t[4] * u - t[5] * y, t[1] + t[5] * x - t[3] * u, t[2] + t[3] * y - t[4] * x
            fastest = max(fastest, vx * vx + vy * vy + vz * vz)
        spin = math.sqrt(t[3] * t[3] + t[4] * t[4] + t[5] * t[5])
        speeds_out[c] = math.sqrt(fastest) + robot.capsules[c, RADIUS] * spin


@uncounted
def largest_move(
    robot: SweptRobot, item: int, shares: Floats, speeds: Floats, accelerations: Floats, half: float
) -> float:
    """Return how far a capsule moves, or how much closer a pair comes, within `half` of the motion on either side [m].

    By what `joint_shares` (c, n), `capsule_speeds` (c,) and `capsule_accelerations` (c,) have; pairs are numbered
    behind the capsules.
    """
    count = robot.capsules.shape[0]
    if item < count:
        by_speed: float = half * (speeds[item] + 0.5 * half * accelerations[item])
        return min(float(shares[item, 0]), by_speed)
    bound: float = 0.0
    for e in range(2):
        if robot.apart[item - count, e] > 0:
            bound += shares[robot.own[item - count, e], robot.apart[item - count, e]]
    return bound


@uncounted
def changing(robot: SweptRobot, turns: Floats, slides: Floats, moving: Integers, items_out: Integers) -> int:
    """Write the capsules that move, and the pairs that move against each other, (c + k,); return their count.

    Turns (n,) and slides (n, 2) are those of `spreads`; scratch (n,).
    """
    found, count, parents = 0, robot.capsules.shape[0], robot.joints.parents
    moving[0] = 0  # joints that move, from the root up to each
    for j in range(1, parents.shape[0]):
        moving[j] = moving[parents[j]] + (1 if turns[j] > 0.0 or slides[j, 0] > 0.0 else 0)
    for item in range(count + robot.own.shape[0]):
        changes = item < count and moving[robot.parent_joints[item]] > 0
        if item >= count:
            for e in range(2):
                top = robot.apart[item - count, e]
                changes |= top > 0 and moving[robot.parent_joints[robot.own[item - count, e]]] > moving[parents[top]]
        if changes:
            items_out[found] = item
            found += 1
    return found


_DEEPEST = 14  # a motion is halved no more often than this: what is in doubt then is a no
_STACK = 64  # parts of a motion, or of an axis, that wait at most; nothing checks it


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
    """Tell if the axis of capsule c is farther than `keep` from all obstacles: halved until each part is decided."""
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
    """Place the capsules at local coordinates, and the balls about them: their middles, and their radii."""
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


@kernel
def motion_apart(
    robot: SweptRobot, tables: DistanceTables, z0: Row, z1: Row, margin: float, self_margin: float, floor: float
) -> bool:
    """Tell if the capsules stay apart all along the straight motion between local coordinates (nv,) [rad or m].

    They keep `margin` from obstacles and `self_margin` from each other [m]; a part of the motion that moves a capsule
    by at most `floor` is not halved any more [m].
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
        judged = robot.parent_joints[item] > 0 if item < count else not _far(robot, item, balls, 0.0, self_margin)
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
            # only what could not be told apart is examined again; the second half waits for the first to be done
            counts[depth + 1] = left
            waiting[top, 0], waiting[top, 1], depths[top] = t, t1, depth + 1
            waiting[top + 1, 0], waiting[top + 1, 1], depths[top + 1] = t0, t, depth + 1
            top += 2
    return True
