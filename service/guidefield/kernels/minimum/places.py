"""A robot placed at a time of a motion: its bodies, how far they are from the joints' axes, how fast they are."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from guidefield.kernels.jit.no_refcount import uncounted
from guidefield.kernels.jit.signatures import Floats, Integers
from guidefield.kernels.kinematics.chart import configuration, subspaces_by_chart
from guidefield.kernels.kinematics.forward_kinematics import joint_placements, motion_subspaces
from guidefield.kernels.kinematics.poses import moved_by
from guidefield.kernels.minimum.curve_rates import piece_at, point_of, share_at
from guidefield.kernels.minimum.tables import BodyPairs, MovingRobot, RobotBodies

TWIST = 6
"""Numbers of a twist."""


class Places(NamedTuple):
    """A robot at some times; a row each, overwritten as a search needs it.

    Attributes:
        times: Shape (s,) [s].
        poses: Of the joints, shape (s, joints, 3, 4) [m].
        centres: Of the balls about bodies, shape (s, r, 3) [m, world].
        reach: Largest distance of each body from each axis that is asked for (`BodyPairs.reached`), 1 from one that
            slides, shape (s, r, n) [m].
        speeds: Bounds of the speeds of bodies, then of how fast the bodies of each own pair move, both together, as
            they are seen from a body between them, shape (s, r + own) [m/s]; infinite where the rates jump.
    """

    times: Floats
    poses: Floats
    centres: Floats
    reach: Floats
    speeds: Floats


class Room(NamedTuple):
    """Scratch of `place`.

    Attributes:
        row: Shape (MOST_ORDER,).
        z, rates: Of the group, shape (nv,).
        values, changes: The same of the model, shape (n,).
        q: Configuration of the model, shape (nq,).
        subspaces, twists: Shape (n, TWIST).
        squares: Shape (n,).
    """

    row: Floats
    z: Floats
    rates: Floats
    values: Floats
    changes: Floats
    q: Floats
    subspaces: Floats
    twists: Floats
    squares: Floats


@uncounted
def place(moving: MovingRobot, time: float, jumps: bool, s: int, places: Places, room: Room) -> None:
    """Place the robot at a time, as row s of the places.

    Args:
        moving: The robot, its pairs and the motion.
        time: When [s].
        jumps: Whether a rate jumps there.
        s: The row.
        places: Where it is written.
        room: Scratch.
    """
    robot, curve = moving.robot, moving.curve
    piece = piece_at(curve, time)
    share = share_at(curve, piece, time)
    point_of(curve.positions, piece, share, room.row, room.z)
    point_of(curve.velocities, piece, share, room.row, room.rates)
    joints, n = robot.joints, robot.offset.shape[0]
    for i in range(n):
        value, change = robot.offset[i], 0.0
        for j in range(room.z.shape[0]):
            value += robot.expand[i, j] * room.z[j]
            change += robot.expand[i, j] * room.rates[j]
        room.values[i], room.changes[i] = value, change
    configuration(joints, room.values, robot.origin, room.q)
    poses = places.poses[s]
    joint_placements(joints.parents, joints.kinds, joints.axes, joints.placements, joints.idx_q, room.q, poses)
    motion_subspaces(joints.kinds, joints.axes, joints.idx_v, joints.nv, poses, room.subspaces)
    places.times[s] = time
    for b in range(robot.carriers.shape[0]):
        x, y, z = moved_by(poses[robot.carriers[b]], robot.centres[b, 0], robot.centres[b, 1], robot.centres[b, 2])
        places.centres[s, b, 0], places.centres[s, b, 1], places.centres[s, b, 2] = x, y, z
        _reach(robot, b, x, y, z, moving.pairs.reached[b], room, places.reach[s, b])
    subspaces_by_chart(joints, room.values, room.q, room.subspaces)
    for i in range(n):
        for k in range(TWIST):
            room.twists[i, k] = room.changes[i] * room.subspaces[i, k]
    _write_speeds(robot, moving.pairs, jumps, s, places, room)


@uncounted
def _reach(
    robot: RobotBodies, b: int, x: float, y: float, z: float, reached: np.ndarray, room: Room, reach_out: Floats
) -> None:
    """Largest distance of a body, whose ball is about (x, y, z), from the axes (n,) that are asked for.

    See `MotionBound.reach`.
    """
    n = robot.offset.shape[0]
    for i in range(n):
        S = room.subspaces[i]
        vx = S[0] + S[4] * z - S[5] * y
        vy = S[1] + S[5] * x - S[3] * z
        vz = S[2] + S[3] * y - S[4] * x
        room.squares[i] = vx * vx + vy * vy + vz * vz
    for i in range(n):
        if not reached[i]:
            reach_out[i] = 0.0
            continue
        square = 0.0
        for k in range(n):
            square += robot.centred[k, i] * room.squares[k]
        reach_out[i] = math.sqrt(square) + robot.turns[i] * robot.radii[b]


@uncounted
def _speed(robot: RobotBodies, b: int, by: Integers, centre: Floats, room: Room) -> float:
    """Bound of the speed of a body's points that some coordinates, those before -1 (n,), move alone [m/s]."""
    vx, vy, vz, wx, wy, wz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(by.shape[0]):
        if by[k] < 0:
            break
        S = room.twists[by[k]]
        vx, vy, vz = vx + S[0], vy + S[1], vz + S[2]
        wx, wy, wz = wx + S[3], wy + S[4], wz + S[5]
    x, y, z = centre[0], centre[1], centre[2]
    vx, vy, vz = vx + wy * z - wz * y, vy + wz * x - wx * z, vz + wx * y - wy * x
    radius = float(robot.radii[b])
    return math.sqrt(vx * vx + vy * vy + vz * vz) + math.sqrt(wx * wx + wy * wy + wz * wz) * radius


@uncounted
def _write_speeds(robot: RobotBodies, pairs: BodyPairs, jumps: bool, s: int, places: Places, room: Room) -> None:
    r = robot.carriers.shape[0]
    for b in range(r):
        speed = _speed(robot, b, robot.moved_by[b], places.centres[s, b], room)
        places.speeds[s, b] = np.inf if jumps else speed
    for own in range(pairs.first_by.shape[0]):
        a, b = pairs.first[own], pairs.second[own]
        speed = _speed(robot, a, pairs.first_by[own], places.centres[s, a], room)
        speed += _speed(robot, b, pairs.second_by[own], places.centres[s, b], room)
        places.speeds[s, r + own] = np.inf if jumps else speed
