"""A robot placed at a time of a motion: its bodies, and how its coordinates move them."""

from __future__ import annotations

from typing import NamedTuple

from guidefield.kernels.jit.no_refcount import uncounted
from guidefield.kernels.jit.signatures import Floats
from guidefield.kernels.kinematics.chart import place_by_chart, subspaces_by_chart
from guidefield.kernels.kinematics.forward_kinematics import place_subspaces
from guidefield.kernels.kinematics.poses import moved_by
from guidefield.kernels.prove.curve_ways import write_point
from guidefield.kernels.prove.tables import MovingRobot, RobotBodies

TWIST = 6
"""Numbers of a twist."""


class Place(NamedTuple):
    """A robot at a time; overwritten as a search needs it.

    Attributes:
        poses: Of the joints, shape (joints, 3, 4) [m].
        centres: Of the balls about bodies, shape (r, 3) [m, world].
        subspaces: The joints' motion subspaces, shape (n, TWIST).
        twists: How each coordinate of the model moves what it moves as it changes, shape (n, TWIST) [m and rad, world].
    """

    poses: Floats
    centres: Floats
    subspaces: Floats
    twists: Floats


class Room(NamedTuple):
    """Scratch of `place_at`.

    Attributes:
        weights: Shape (MOST_ORDER,).
        z, straight: Of the group, where it is and how far it goes, shape (nv,).
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
def place_at(moving: MovingRobot, time: float, place: Place, room: Room) -> None:
    """Place the robot at a time.

    Args:
        moving: The robot and its motion.
        time: When [s].
        place: Where poses and centres are written.
        room: Scratch.
    """
    robot = moving.robot
    write_point(moving.curve, time, room.weights, room.z)
    for i in range(robot.offset.shape[0]):
        value = robot.offset[i]
        for j in range(room.z.shape[0]):
            value += robot.expand[i, j] * room.z[j]
        room.values[i] = value
    place_by_chart(robot.joints, room.values, robot.origin, room.q, room.rotation, room.translation, place.poses)
    place_centres(robot, place)


@uncounted
def place_centres(robot: RobotBodies, place: Place) -> None:
    """Write the centres of the balls about the robot's bodies, whose joints are placed."""
    for b in range(robot.carriers.shape[0]):
        pose = place.poses[robot.carriers[b]]
        x, y, z = moved_by(pose, robot.centres[b, 0], robot.centres[b, 1], robot.centres[b, 2])
        place.centres[b, 0], place.centres[b, 1], place.centres[b, 2] = x, y, z


@uncounted
def find_twists(moving: MovingRobot, place: Place, room: Room) -> None:
    """Write how the coordinates move the robot where it was placed last, with that scratch, as they change by it."""
    joints = moving.robot.joints
    place_subspaces(joints.kinds, joints.axes, joints.idx_v, joints.nv, place.poses, place.subspaces)
    for i in range(room.changes.shape[0]):
        for k in range(TWIST):
            place.twists[i, k] = place.subspaces[i, k]
    subspaces_by_chart(joints, room.values, room.q, place.twists)
    for i in range(room.changes.shape[0]):
        for k in range(TWIST):
            place.twists[i, k] *= room.changes[i]
