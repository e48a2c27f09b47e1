"""Bounds on the motion of capsules that a robot's joints carry, along a straight motion in local coordinates.

Two bounds, both rigorous: the sum of what the joints do (collision/motion_bound.py has its proof), and a capsule's
speed at the middle of the motion with its largest acceleration, which counts what joints undo of each other.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from guidefield.kernels.jit.fields import IndexRows, Indices, Row, Rows, numba_type
from guidefield.kernels.jit.no_refcount import uncounted
from guidefield.kernels.jit.signatures import Floats, Integers
from guidefield.kernels.kinematics.chart import subspaces_by_chart
from guidefield.kernels.kinematics.forward_kinematics import (
    CONTINUOUS,
    FLOATING,
    PLANAR,
    PRISMATIC,
    REVOLUTE,
    JointTable,
    motion_subspaces,
)
from guidefield.kernels.kinematics.poses import moved_by, turned_by

FIRST_END, SECOND_END, RADIUS, CAPSULE = 0, 3, 6, 7
"""Columns of a capsule: the ends of its axis (3 each) and its radius [m]; then how many columns there are."""


class SweptRobot(NamedTuple):
    """A robot as capsules that its joints carry.

    Attributes:
        joints: The joints of its model.
        origin: (nq,) configuration from which the chart's rotation vectors start.
        capsules: (c, CAPSULE) ends and radius in the frame of their joint [m].
        carriers: (c,) the joint of each; 0 stands still.
        own: (k, 2) capsules that must not touch each other.
        apart: (k, 2) of the joints that move one of these and not the other the one nearest to the root, for both; 0
            where there is none.
    """

    joints: JointTable
    origin: Row
    capsules: Rows
    carriers: Indices
    own: IndexRows
    apart: IndexRows


SWEPT = numba_type(SweptRobot)


@uncounted
def spreads(robot: SweptRobot, z0: Floats, z1: Floats, turns_out: Floats, slides_out: Floats) -> None:
    """Return how far each joint turns and slides along the whole motion.

    Args:
        robot: The capsules.
        z0: Start in the chart of the robot's model, shape (nv,) [rad or m].
        z1: End, shape (nv,).
        turns_out: Shape (n,) [rad].
        slides_out: How far it slides, and how far out it is at most, shape (n, 2) [m].
    """
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
    """Ends of the capsules' axes in the world.

    Args:
        robot: The capsules.
        world: Placements of joints, shape (n, 3, 4) [m].
        ends_out: Shape (c, 6) [m].
    """
    for c in range(robot.capsules.shape[0]):
        T = world[robot.carriers[c]]
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
    """Return how far the joints between each capsule and the root move it at most within a part of the motion.

    Args:
        robot: The capsules.
        world: Placements of joints at the middle of the part, shape (n, 3, 4) [m].
        ends: Ends of the capsules there, shape (c, 6) [m].
        turns: As `spreads` has them, shape (n,) [rad].
        slides: As `spreads` has them, shape (n, 2) [m].
        half: Half of the part, as a share of the whole motion.
        chords: Scratch, shape (n,).
        shares_out: What all from the capsule's on up to and with each of them do together, shape (c, n) [m]; in the
            first column, which is the world's, that of all. Nothing is written for joints that don't move it.
    """
    parents = robot.joints.parents
    for j in range(1, parents.shape[0]):
        chords[j] = 2.0 * math.sin(0.5 * min(half * turns[j], math.pi))
    for c in range(robot.capsules.shape[0]):
        together, j = 0.0, robot.carriers[c]
        while j > 0:
            if turns[j] > 0.0 or slides[j, 0] > 0.0:
                lever = max(_lever(robot, j, world, ends[c, :3]), _lever(robot, j, world, ends[c, 3:6]))
                together += half * slides[j, 0] + chords[j] * (lever + robot.capsules[c, RADIUS])
            shares_out[c, j] = together
            j = parents[j]
        shares_out[c, 0] = together


@uncounted
def capsule_accelerations(robot: SweptRobot, turns: Floats, slides: Floats, out: Floats) -> None:
    """Bound on the acceleration of each capsule's points along the motion, time running from 0 to 1.

    Up from the capsule's joint: a joint with p + R X before it, |p'| = s constant, turning at w at most, makes of
    bounds r, v, a on X, X', X'' the bounds |p| + r, s + w r + v and 3/2 w^2 r + 2 w v + a. Its angular velocity
    J_r(z) z' changes by w^2 / 2 at most, as J_r(z) is the mean of exp(-u [z]) over u from 0 to 1; about one axis it
    doesn't change. The length |p| of slides is at most what they are at the end they are longer at.

    Args:
        robot: The capsules.
        turns: As `spreads` has them, shape (n,) [rad].
        slides: As `spreads` has them, shape (n, 2) [m].
        out: Shape (c,) [m].
    """
    for c in range(robot.capsules.shape[0]):
        row = robot.capsules[c]
        x, y, z = row[FIRST_END], row[FIRST_END + 1], row[FIRST_END + 2]
        u, v, w = row[SECOND_END], row[SECOND_END + 1], row[SECOND_END + 2]
        r = row[RADIUS] + math.sqrt(max(x * x + y * y + z * z, u * u + v * v + w * w))
        v, a = 0.0, 0.0
        j = robot.carriers[c]
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
    """Write the speed of the fastest point of each capsule at a configuration, time running from 0 to 1.

    Args:
        robot: The capsules.
        world: Placements of joints, shape (n, 3, 4) [m].
        z: Chart point, shape (nv,) [rad or m].
        q: Its configuration, shape (nq,).
        dz: The whole motion, shape (nv,).
        ends: Ends of the capsules, shape (c, 6) [m].
        subspaces: Scratch, shape (nv, 6).
        twists: Scratch, shape (n, 6).
        speeds_out: Shape (c,) [m].
    """
    joints = robot.joints
    motion_subspaces(joints, world, subspaces)
    subspaces_by_chart(joints, z, q, subspaces)
    twists[0, :] = 0.0
    for i in range(1, joints.parents.shape[0]):
        for k in range(6):
            value = twists[joints.parents[i], k]
            for r in range(joints.idx_v[i], joints.idx_v[i] + joints.nv[i]):
                value += subspaces[r, k] * dz[r]
            twists[i, k] = value
    for c in range(robot.capsules.shape[0]):
        t = twists[robot.carriers[c]]
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

    Args:
        robot: The capsules.
        item: Which capsule, or capsules + which of its own pairs.
        shares: As `joint_shares` has them, shape (c, n) [m].
        speeds: As `capsule_speeds` has them, shape (c,) [m].
        accelerations: As `capsule_accelerations` has them, shape (c,) [m].
        half: As in `joint_shares`.
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
    """Capsules that move, and pairs that move against each other; how many.

    Args:
        robot: The capsules.
        turns: As `spreads` has them, shape (n,) [rad].
        slides: As `spreads` has them, shape (n, 2) [m].
        moving: Scratch, shape (n,).
        items_out: Capsules, then capsules + pairs, shape (c + k,).
    """
    found, count, parents = 0, robot.capsules.shape[0], robot.joints.parents
    moving[0] = 0  # joints that move, from the root up to each
    for j in range(1, parents.shape[0]):
        moving[j] = moving[parents[j]] + (1 if turns[j] > 0.0 or slides[j, 0] > 0.0 else 0)
    for item in range(count + robot.own.shape[0]):
        changes = item < count and moving[robot.carriers[item]] > 0
        if item >= count:
            for e in range(2):
                top = robot.apart[item - count, e]
                changes |= top > 0 and moving[robot.carriers[robot.own[item - count, e]]] > moving[parents[top]]
        if changes:
            items_out[found] = item
            found += 1
    return found
