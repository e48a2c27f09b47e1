"""Whether capsules about a robot's links stay apart from obstacles and each other along a straight motion of its chart.

A yes is rigorous: halves of the motion are judged at their middles, where every capsule has to keep more than it can
lose within the half (collision/motion_bound.py has the bound and its proof). A no only says that capsules can't tell.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import types

from guidefield.kernels.chart import configuration
from guidefield.kernels.distance import INDEX_MATRIX, TABLES, DistanceTables, bodies_near, nearest_body
from guidefield.kernels.sampled_robot import JOINTS
from guidefield.kernels.signatures import MATRIX, SCALAR, VECTOR, Floats, compiled, inlined
from guidefield.kernels.tree_kinematics import (
    CONTINUOUS,
    FLOATING,
    INDICES,
    PLANAR,
    PRISMATIC,
    REVOLUTE,
    Integers,
    JointTable,
    joint_placements,
)

_DEEPEST = 14
"""A motion is halved no more often than this."""

_STACK = 64


class SweptRobot(NamedTuple):
    """A robot as capsules that its joints carry.

    Attributes:
        joints: The joints of its model.
        origin: (nq,) configuration from which the chart's rotation vectors start.
        capsules: (c, 7) ends and radius in the frame of their joint [m].
        carriers: (c,) the joint of each; 0 stands still.
        moved: (c, n) 1 where a joint moves a capsule.
        own: (k, 2) capsules that must not touch each other.
    """

    joints: JointTable
    origin: Floats
    capsules: Floats
    carriers: Integers
    moved: Integers
    own: Integers


SWEPT = types.NamedTuple((JOINTS, VECTOR, MATRIX, INDICES, INDEX_MATRIX, INDEX_MATRIX), SweptRobot)


@inlined
def _spreads(robot: SweptRobot, dz: Floats, turns_out: Floats, slides_out: Floats) -> None:
    """How far each joint turns [rad] and slides [m] along the whole motion, shape (n,)."""
    for i in range(1, robot.joints.parents.shape[0]):
        at, kind = robot.joints.idx_v[i], robot.joints.kinds[i]
        turns_out[i], slides_out[i] = 0.0, 0.0
        if kind in (REVOLUTE, CONTINUOUS):
            turns_out[i] = abs(dz[at])
        elif kind == PRISMATIC:
            slides_out[i] = abs(dz[at])
        elif kind == PLANAR:
            slides_out[i] = math.sqrt(dz[at] ** 2 + dz[at + 1] ** 2)
            turns_out[i] = abs(dz[at + 2])
        else:
            first = at
            if kind == FLOATING:
                slides_out[i] = math.sqrt(dz[at] ** 2 + dz[at + 1] ** 2 + dz[at + 2] ** 2)
                first = at + 3
            turns_out[i] = math.sqrt(dz[first] ** 2 + dz[first + 1] ** 2 + dz[first + 2] ** 2)


@inlined
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
        along = 0.0
        along += dx * (T[0, 0] * x + T[0, 1] * y + T[0, 2] * z)
        along += dy * (T[1, 0] * x + T[1, 1] * y + T[1, 2] * z)
        along += dz * (T[2, 0] * x + T[2, 1] * y + T[2, 2] * z)
        square = max(square - along * along, 0.0)
    return math.sqrt(square)


@inlined
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


@inlined
def _keeps(ends: Floats, c: int, keep: float, tables: DistanceTables, candidates: Integers, stack: Floats) -> bool:
    """Whether the axis of capsule c is farther than `keep` from all obstacles: halved until every part tells."""
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


@inlined
def _capsule_ends(robot: SweptRobot, world: Floats, ends_out: Floats) -> None:
    """Ends (c, 6) of the capsules' axes in the world."""
    for c in range(robot.capsules.shape[0]):
        T = world[robot.carriers[c]]
        for e in range(2):
            x, y, z = robot.capsules[c, 3 * e], robot.capsules[c, 3 * e + 1], robot.capsules[c, 3 * e + 2]
            for r in range(3):
                ends_out[c, 3 * e + r] = T[r, 0] * x + T[r, 1] * y + T[r, 2] * z + T[r, 3]


@inlined
def _shares(
    robot: SweptRobot, world: Floats, ends: Floats, turns: Floats, slides: Floats, half: float, shares_out: Floats
) -> None:
    """How far each joint moves each capsule at most within `half` of the motion on either side, shape (c, n) [m]."""
    for c in range(robot.capsules.shape[0]):
        radius = robot.capsules[c, 6]
        for j in range(1, robot.joints.parents.shape[0]):
            share = 0.0
            if robot.moved[c, j] == 1 and (turns[j] > 0.0 or slides[j] > 0.0):
                lever = max(_lever(robot, j, world, ends[c, :3]), _lever(robot, j, world, ends[c, 3:6])) + radius
                share = half * slides[j] + 2.0 * math.sin(0.5 * min(half * turns[j], math.pi)) * lever
            shares_out[c, j] = share


@inlined
def _worst(
    robot: SweptRobot, tables: DistanceTables, ends: Floats, shares: Floats, margin: float, self_margin: float,
    candidates: Integers, stack: Floats,
) -> float:  # fmt: skip
    """The bound of the first capsule or pair that can't be told apart [m]; -1 if all are apart."""
    n = robot.joints.parents.shape[0]
    for c in range(robot.capsules.shape[0]):
        if robot.carriers[c] == 0:
            continue
        bound = 0.0
        for j in range(1, n):
            bound += shares[c, j]
        if not _keeps(ends, c, robot.capsules[c, 6] + margin + bound, tables, candidates, stack):
            return bound
    for k in range(robot.own.shape[0]):
        a, b = robot.own[k, 0], robot.own[k, 1]
        bound = 0.0
        for j in range(1, n):
            if robot.moved[a, j] != robot.moved[b, j]:
                bound += shares[a, j] + shares[b, j]
        if _segment_distance(ends, a, b) <= robot.capsules[a, 6] + robot.capsules[b, 6] + self_margin + bound:
            return bound
    return -1.0


@compiled(types.boolean(SWEPT, TABLES, VECTOR, VECTOR, SCALAR, SCALAR, SCALAR))
def motion_apart(
    robot: SweptRobot, tables: DistanceTables, z0: Floats, z1: Floats, margin: float, self_margin: float, floor: float
) -> bool:
    """Whether the capsules stay apart all along the straight motion from z0 to z1.

    Args:
        robot: The capsules.
        tables: The obstacles.
        z0: Start in the chart of the robot's model, shape (nv,) [rad or m].
        z1: End, shape (nv,).
        margin: What capsules keep from obstacles at least [m].
        self_margin: What they keep from each other at least [m].
        floor: A part of the motion that moves a capsule by no more than this is not halved any more [m].
    """
    joints = robot.joints
    n, count = joints.parents.shape[0], robot.capsules.shape[0]
    world, ends, shares = np.empty((n, 3, 4)), np.empty((count, 6)), np.zeros((count, n))
    turns, slides, z = np.zeros(n), np.zeros(n), np.empty(z0.shape[0])
    q = np.empty(robot.origin.shape[0])
    candidates = np.empty(tables.kinds.shape[0], np.int64)
    parts, waiting = np.empty((_STACK, 2)), np.empty((_STACK, 2))
    _spreads(robot, z1 - z0, turns, slides)
    # the end first: most motions that are refused end in contact
    waiting[0, 0], waiting[0, 1] = 0.0, 1.0
    waiting[1, 0], waiting[1, 1] = 1.0, 1.0
    top = 2
    while top > 0:
        top -= 1
        t0, t1 = waiting[top, 0], waiting[top, 1]
        t, half = 0.5 * (t0 + t1), 0.5 * (t1 - t0)
        for k in range(z0.shape[0]):
            z[k] = z0[k] + t * (z1[k] - z0[k])
        configuration(joints, z, robot.origin, q)
        joint_placements(joints.parents, joints.kinds, joints.axes, joints.placements, joints.idx_q, q, world)
        _capsule_ends(robot, world, ends)
        _shares(robot, world, ends, turns, slides, half, shares)
        bound = _worst(robot, tables, ends, shares, margin, self_margin, candidates, parts)
        if bound < 0.0:
            continue
        if bound <= floor or half < 0.5**_DEEPEST:
            return False
        waiting[top, 0], waiting[top, 1] = t, t1
        waiting[top + 1, 0], waiting[top + 1, 1] = t0, t
        top += 2
    return True
