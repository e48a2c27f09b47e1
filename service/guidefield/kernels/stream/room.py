"""Distances of a robot from moving obstacles, for planning alone: balls about its links, rounded boxes for obstacles.

What this says is quick, errs to the safe side and proves nothing: the judge, which shares none of it, has the word.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import boolean

from guidefield.kernels.jit.arrays import MATRIX, VECTOR, Floats, Indices, Row, RowOut, Rows, numba_type
from guidefield.kernels.jit.decorators import inlined, kernel, lane_step
from guidefield.kernels.kinematics.forward_kinematics import (
    PRISMATIC,
    GroupJoints,
    JointPlaces,
    place_group,
    velocity_by,
    write_twists,
)
from guidefield.kernels.kinematics.poses import moved_by


class RoomRobot(NamedTuple):
    """A robot as balls."""

    joints: GroupJoints  # its joints, each of which turns about one axis or slides along one
    carriers: Indices  # the joint that carries each body that moves, shape (r,)
    bounds: Rows  # centre and radius of a ball about each, in its joint's frame, shape (r, 4) [m]
    first: Indices  # where its balls begin, and the number of all, shape (r + 1,)
    balls: Rows  # balls that hold it together, shape (s, 4) [m]
    places: JointPlaces  # memory: placements and twists of the joints


ROOM_ROBOT = numba_type(RoomRobot)

ROUNDED_BOX = 16
"""Numbers of a rounded box: rotation by rows and translation, halves of its sides, radius of the rounding [m]."""


@inlined
def _distance(box: Floats, x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Distance of a point of the world from a rounded box, shape (16,), and its gradient; negative inside [m]."""
    dx, dy, dz = x - box[3], y - box[7], z - box[11]
    a = box[0] * dx + box[4] * dy + box[8] * dz
    b = box[1] * dx + box[5] * dy + box[9] * dz
    c = box[2] * dx + box[6] * dy + box[10] * dz
    u, v, w = abs(a) - box[12], abs(b) - box[13], abs(c) - box[14]
    u_, v_, w_ = max(u, 0.0), max(v, 0.0), max(w, 0.0)
    outside = math.sqrt(u_ * u_ + v_ * v_ + w_ * w_)
    if outside > 0.0:
        ga = math.copysign(u_ / outside, a)
        gb = math.copysign(v_ / outside, b)
        gc = math.copysign(w_ / outside, c)
        d = outside
    else:
        d = max(u, v, w)
        ga = math.copysign(1.0, a) if u >= v and u >= w else 0.0
        gb = math.copysign(1.0, b) if v > u and v >= w else 0.0
        gc = math.copysign(1.0, c) if w > u and w > v else 0.0
    nx = box[0] * ga + box[1] * gb + box[2] * gc
    ny = box[4] * ga + box[5] * gb + box[6] * gc
    nz = box[8] * ga + box[9] * gb + box[10] * gc
    return d - box[15], nx, ny, nz


@kernel
def distances(robot: RoomRobot, boxes: Rows, z: Row, cut: float, least: RowOut) -> None:
    """Write how far the robot is from each of boxes (k, `ROUNDED_BOX`) at coordinates z (nv,), at most `cut`; (k,) [m].

    It may be nearer by what its balls reach beyond its links.
    """
    place_group(robot.joints, z, robot.places)
    for k in range(boxes.shape[0]):
        box = boxes[k]
        least[k] = cut
        size = math.sqrt(box[12] ** 2 + box[13] ** 2 + box[14] ** 2) + box[15]
        for body in range(robot.carriers.shape[0]):
            pose, ball = robot.places.poses[robot.carriers[body]], robot.bounds[body]
            x, y, t = moved_by(pose, ball[0], ball[1], ball[2])
            reach = size + ball[3] + least[k]
            if (x - box[3]) ** 2 + (y - box[7]) ** 2 + (t - box[11]) ** 2 >= reach * reach:
                continue
            for i in range(robot.first[body], robot.first[body + 1]):
                ball = robot.balls[i]
                x, y, t = moved_by(pose, ball[0], ball[1], ball[2])
                least[k] = min(least[k], _distance(box, x, y, t)[0] - ball[3])


@kernel
def pressure(robot: RoomRobot, boxes: Rows, z: Row, cut: float, gradient: RowOut) -> float:
    """Sum (cut - d)^2 / 2 over balls and boxes (k, `ROUNDED_BOX`) closer than `cut` [m^2]; gradient (nv,)."""
    place_group(robot.joints, z, robot.places)
    write_twists(robot.joints, robot.places)
    table = robot.joints.table
    gradient[:] = 0.0
    whole = 0.0
    for k in range(boxes.shape[0]):
        box = boxes[k]
        size = math.sqrt(box[12] ** 2 + box[13] ** 2 + box[14] ** 2) + box[15]
        for body in range(robot.carriers.shape[0]):
            pose, ball = robot.places.poses[robot.carriers[body]], robot.bounds[body]
            x, y, t = moved_by(pose, ball[0], ball[1], ball[2])
            reach = size + ball[3] + cut
            if (x - box[3]) ** 2 + (y - box[7]) ** 2 + (t - box[11]) ** 2 >= reach * reach:
                continue
            for i in range(robot.first[body], robot.first[body + 1]):
                ball = robot.balls[i]
                x, y, t = moved_by(pose, ball[0], ball[1], ball[2])
                d, nx, ny, nz = _distance(box, x, y, t)
                lack = cut - (d - ball[3])
                if lack <= 0.0:
                    continue
                whole += 0.5 * lack * lack
                joint = robot.carriers[body]
                while joint > 0:
                    row = table.idx_v[joint]
                    vx, vy, vz = velocity_by(robot.places.twists[row], x, y, t)
                    rate = nx * vx + ny * vy + nz * vz
                    gradient[robot.joints.sources[row]] -= lack * rate * robot.joints.multipliers[row]
                    joint = table.parents[joint]
    return whole


@lane_step(boolean(ROOM_ROBOT, MATRIX, VECTOR, VECTOR))
def blocked(robot: RoomRobot, boxes: Floats, grown: Floats, z: Floats) -> bool:
    """Tell if the robot at z (nv,) comes closer to any of boxes (k, `ROUNDED_BOX`) than `grown` (k,) [m]."""
    place_group(robot.joints, z, robot.places)
    for body in range(robot.carriers.shape[0]):
        pose, ball = robot.places.poses[robot.carriers[body]], robot.bounds[body]
        x, y, t = moved_by(pose, ball[0], ball[1], ball[2])
        for k in range(boxes.shape[0]):
            box = boxes[k]
            size = math.sqrt(box[12] ** 2 + box[13] ** 2 + box[14] ** 2) + box[15]
            reach = size + ball[3] + grown[k]
            away = (x - box[3]) ** 2 + (y - box[7]) ** 2 + (t - box[11]) ** 2
            if reach <= 0.0 or away >= reach * reach or _distance(box, x, y, t)[0] >= ball[3] + grown[k]:
                continue
            for i in range(robot.first[body], robot.first[body + 1]):
                u, v, w = moved_by(pose, robot.balls[i, 0], robot.balls[i, 1], robot.balls[i, 2])
                if _distance(box, u, v, w)[0] - robot.balls[i, 3] < grown[k]:
                    return True
    return False


@kernel
def swept(robot: RoomRobot, z: Row, tolerance: float) -> float:
    """Bound the motion of the robot's points at z (nv,) where each coordinate is off by a tolerance [m]."""
    place_group(robot.joints, z, robot.places)
    write_twists(robot.joints, robot.places)
    table, most = robot.joints.table, 0.0
    for body in range(robot.carriers.shape[0]):
        joint, ball = robot.carriers[body], robot.bounds[body]
        x, y, t = moved_by(robot.places.poses[joint], ball[0], ball[1], ball[2])
        whole = 0.0
        while joint > 0:
            row = table.idx_v[joint]
            off = abs(robot.joints.multipliers[row]) * tolerance
            if table.kinds[joint] == PRISMATIC:
                whole += off
            else:
                vx, vy, vz = velocity_by(robot.places.twists[row], x, y, t)
                far = math.sqrt(vx * vx + vy * vy + vz * vz) + ball[3]
                whole += 2.0 * math.sin(0.5 * min(off, math.pi)) * far
            joint = table.parents[joint]
        most = max(most, whole)
    return most


def nearest(robot: RoomRobot, boxes: Floats, z: Floats, cut: float) -> Floats:
    """`distances` in an array of their own, shape (k,) [m]."""
    least = np.empty(len(boxes))
    distances(robot, boxes, z, cut, least)
    return least
