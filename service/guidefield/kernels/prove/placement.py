"""The placement of a robot, and of obstacles that move, at a parameter of a motion; twists of the joints there."""

from __future__ import annotations

import math
from typing import NamedTuple

from guidefield.kernels.jit.no_refcount import uncounted
from guidefield.kernels.jit.signatures import Floats, Vector3
from guidefield.kernels.kinematics.chart import place_by_chart, subspaces_by_chart
from guidefield.kernels.kinematics.forward_kinematics import place_subspaces
from guidefield.kernels.kinematics.poses import moved_by
from guidefield.kernels.prove.bezier import time_at, write_point
from guidefield.kernels.prove.tables import MovingObstacles, MovingRobot, RobotBodies

TWIST = 6
"""Numbers of a twist."""

SMALL_ANGLE = 1e-4
"""Below this angle series stand for sine and cosine [rad]: off by less than rounding."""


NOW, LOOK, MOMENT = range(3)
"""Numbers of a moment: the time [s] and the number of the placement; then how many there are."""


class BodyPoses(NamedTuple):
    """A robot at a parameter, and obstacles that move then; overwritten by the next placement.

    Attributes:
        poses: Of the joints, shape (joints, 3, 4) [m].
        centres: Of the balls about bodies, shape (r, 3) [m, world].
        subspaces: The joints' motion subspaces, shape (n, TWIST).
        twists: Motion by each coordinate of the model as that changes, shape (n, TWIST) [m and rad, world].
        moment: Shape (MOMENT,).
        mover_poses: Motion of each moving obstacle from where it is at first, shape (v, 12) [m, world].
        mover_looks: Number of the placement for which each pose is known, shape (v,).
    """

    poses: Floats
    centres: Floats
    subspaces: Floats
    twists: Floats
    moment: Floats
    mover_poses: Floats
    mover_looks: Floats


class PoseScratch(NamedTuple):
    """Scratch of `place_at`.

    Attributes:
        weights: Shape (MOST_ORDER,).
        z, straight: Local coordinates of the group, and the chord of a segment, shape (nv,).
        values, changes: The same of the model, shape (n,).
        q: Configuration of the model, shape (nq,).
        rotation, translation: Of a joint, shapes (3, 3) and (3,).
    """

    weights: Floats
    z: Floats
    straight: Floats
    values: Floats
    changes: Floats
    q: Floats
    rotation: Floats
    translation: Floats


@uncounted
def place_at(moving: MovingRobot, at: float, place: BodyPoses, scratch: PoseScratch) -> None:
    """Place the robot at a parameter of its motion.

    Args:
        moving: The robot and its motion.
        at: The parameter.
        place: Poses and centres are written to it.
        scratch: Its scratch.
    """
    robot = moving.robot
    write_point(moving.curve, at, scratch.weights, scratch.z)
    for i in range(robot.offset.shape[0]):
        value = robot.offset[i]
        for j in range(scratch.z.shape[0]):
            value += robot.expand[i, j] * scratch.z[j]
        scratch.values[i] = value
    place_by_chart(
        robot.joints, scratch.values, robot.origin, scratch.q, scratch.rotation, scratch.translation, place.poses
    )
    place_centres(robot, place)
    place.moment[NOW] = time_at(moving.curve, at)
    place.moment[LOOK] += 1.0


@uncounted
def step_at(movers: MovingObstacles, mover: int, time: float) -> int:
    """Return the last placement of a moving obstacle at or before a time [s]; one less than its first, if none is."""
    low, high = movers.begins[mover] - 1, movers.begins[mover + 1]
    while high - low > 1:
        middle = (low + high) // 2
        if movers.times[middle] <= time:
            low = middle
        else:
            high = middle
    return int(low)


@uncounted
def place_mover(movers: MovingObstacles, mover: int, place: BodyPoses) -> None:
    """Place a moving obstacle at the moment of a placement, once: exp((t - t_k) twist_k) times its pose at step k."""
    if place.mover_looks[mover] == place.moment[LOOK]:
        return
    place.mover_looks[mover] = place.moment[LOOK]
    pose, time = place.mover_poses[mover], place.moment[NOW]
    step = max(step_at(movers, mover, time), movers.begins[mover])
    known, twist = movers.poses[step], movers.twists[step]
    for k in range(12):
        pose[k] = known[k]
    passed = time - movers.times[step]
    wx, wy, wz = twist[3] * passed, twist[4] * passed, twist[5] * passed
    square = wx * wx + wy * wy + wz * wz
    vx, vy, vz = twist[0] * passed, twist[1] * passed, twist[2] * passed
    if passed <= 0.0 or (square == 0.0 and vx == 0.0 and vy == 0.0 and vz == 0.0):
        return
    angle = math.sqrt(square)
    if angle > SMALL_ANGLE:
        sine = math.sin(angle)
        a, b, c = sine / angle, (1.0 - math.cos(angle)) / square, (angle - sine) / (angle * square)
    else:
        a, b, c = 1.0 - square / 6.0, 0.5 - square / 24.0, 1.0 / 6.0 - square / 120.0
    # each column x of the pose: x + a w x x + b w x (w x x); the origin also by v + b w x v + c w x (w x v)
    for column in range(4):
        x, y, z = known[column], known[4 + column], known[8 + column]
        ux, uy, uz = wy * z - wz * y, wz * x - wx * z, wx * y - wy * x
        pose[column] = x + a * ux + b * (wy * uz - wz * uy)
        pose[4 + column] = y + a * uy + b * (wz * ux - wx * uz)
        pose[8 + column] = z + a * uz + b * (wx * uy - wy * ux)
    ux, uy, uz = wy * vz - wz * vy, wz * vx - wx * vz, wx * vy - wy * vx
    pose[3] += vx + b * ux + c * (wy * uz - wz * uy)
    pose[7] += vy + b * uy + c * (wz * ux - wx * uz)
    pose[11] += vz + b * uz + c * (wx * uy - wy * ux)


@uncounted
def seen_by_mover(pose: Floats, x: float, y: float, z: float) -> Vector3:
    """Return a point as a moving obstacle has it where that is at first, by its pose (12,) [m, world]."""
    dx, dy, dz = x - pose[3], y - pose[7], z - pose[11]
    return (
        pose[0] * dx + pose[4] * dy + pose[8] * dz,
        pose[1] * dx + pose[5] * dy + pose[9] * dz,
        pose[2] * dx + pose[6] * dy + pose[10] * dz,
    )


@uncounted
def place_centres(robot: RobotBodies, place: BodyPoses) -> None:
    """Write the centres of the balls about the robot's bodies, whose joints are placed."""
    for b in range(robot.carriers.shape[0]):
        pose = place.poses[robot.carriers[b]]
        x, y, z = moved_by(pose, robot.centres[b, 0], robot.centres[b, 1], robot.centres[b, 2])
        place.centres[b, 0], place.centres[b, 1], place.centres[b, 2] = x, y, z


@uncounted
def find_twists(moving: MovingRobot, place: BodyPoses, scratch: PoseScratch) -> None:
    """Write the motion by each coordinate where the robot was placed last, with that scratch, as they change by it."""
    joints = moving.robot.joints
    place_subspaces(joints, place.poses, place.subspaces)
    for i in range(scratch.changes.shape[0]):
        for k in range(TWIST):
            place.twists[i, k] = place.subspaces[i, k]
    subspaces_by_chart(joints, scratch.values, scratch.q, place.twists)
    for i in range(scratch.changes.shape[0]):
        for k in range(TWIST):
            place.twists[i, k] *= scratch.changes[i]
