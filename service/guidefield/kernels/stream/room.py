"""How much room a robot has among what moves, for planning alone: balls about its links, rounded boxes for obstacles.

What this says is quick, errs to the safe side and proves nothing: the judge, which shares none of it, has the word.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import boolean, float64, types

from guidefield.kernels.jit.fields import Indices, Row, Rows, RowsOut, numba_type
from guidefield.kernels.jit.signatures import (
    MATRIX,
    SCALAR,
    VECTOR,
    VECTOR_OUT,
    Floats,
    compiled,
    inlined,
    lane_step,
)


class RoomRobot(NamedTuple):
    """A robot as balls. Joint 0 is the world; a joint comes after its parent.

    Attributes:
        parents: Of each joint, shape (n,).
        slides: 1 where a joint slides, 0 where it turns, shape (n,).
        axes: Unit vectors in the joints' own frames, shape (n, 3).
        placements: In the parent's frame, rotation by rows and translation, shape (n, 12) [m].
        drivers: The coordinate that moves each joint, shape (n,).
        multipliers, offsets: Its value is multiplier * coordinate + offset, shape (n,).
        carriers: The joint that carries each body that moves, shape (r,).
        bounds: Centre and radius of a ball about each, in its joint's frame, shape (r, 4) [m].
        first: Where its balls begin, and the number of all, shape (r + 1,).
        balls: Balls that hold it together, shape (s, 4) [m].
        poses: Memory: poses of the joints, shape (n, 12).
        lines: Memory: their axes and origins in the world, shape (n, 6).
    """

    parents: Indices
    slides: Indices
    axes: Rows
    placements: Rows
    drivers: Indices
    multipliers: Row
    offsets: Row
    carriers: Indices
    bounds: Rows
    first: Indices
    balls: Rows
    poses: RowsOut
    lines: RowsOut


ROOM_ROBOT = numba_type(RoomRobot)

ROUNDED_BOX = 16
"""Numbers of a rounded box: rotation by rows and translation, halves of its sides, radius of the rounding [m]."""


@inlined
def _place(robot: RoomRobot, z: Floats) -> None:
    """Place the joints for coordinates z, shape (nv,)."""
    poses, lines = robot.poses, robot.lines
    poses[0] = 0.0
    poses[0, 0] = poses[0, 5] = poses[0, 10] = 1.0
    for j in range(1, robot.parents.shape[0]):
        parent = robot.parents[j]
        value = robot.multipliers[j] * z[robot.drivers[j]] + robot.offsets[j]
        cos, sin = math.cos(value), math.sin(value)
        ax, ay, az = robot.axes[j, 0], robot.axes[j, 1], robot.axes[j, 2]
        for r in range(3):
            row, own = poses[parent], robot.placements[j]
            a, b, c = row[4 * r], row[4 * r + 1], row[4 * r + 2]
            x = a * own[0] + b * own[4] + c * own[8]
            y = a * own[1] + b * own[5] + c * own[9]
            t = a * own[2] + b * own[6] + c * own[10]
            origin = a * own[3] + b * own[7] + c * own[11] + row[4 * r + 3]
            along = x * ax + y * ay + t * az
            lines[j, r], lines[j, 3 + r] = along, origin
            if robot.slides[j] == 1:
                poses[j, 4 * r], poses[j, 4 * r + 1], poses[j, 4 * r + 2] = x, y, t
                poses[j, 4 * r + 3] = origin + value * along
            else:
                poses[j, 4 * r] = cos * x + sin * (y * az - t * ay) + (1.0 - cos) * along * ax
                poses[j, 4 * r + 1] = cos * y + sin * (t * ax - x * az) + (1.0 - cos) * along * ay
                poses[j, 4 * r + 2] = cos * t + sin * (x * ay - y * ax) + (1.0 - cos) * along * az
                poses[j, 4 * r + 3] = origin


@inlined
def _point(pose: Floats, ball: Floats) -> tuple[float, float, float]:
    """Where the centre of a ball, shape (4,), of a joint with a pose, shape (12,), is in the world [m]."""
    x = pose[0] * ball[0] + pose[1] * ball[1] + pose[2] * ball[2] + pose[3]
    y = pose[4] * ball[0] + pose[5] * ball[1] + pose[6] * ball[2] + pose[7]
    t = pose[8] * ball[0] + pose[9] * ball[1] + pose[10] * ball[2] + pose[11]
    return x, y, t


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


@compiled(types.void(ROOM_ROBOT, MATRIX, VECTOR, SCALAR, VECTOR_OUT))
def distances(robot: RoomRobot, boxes: Floats, z: Floats, cut: float, least: Floats) -> None:
    """How far the robot is from each of some boxes, at most by what its balls leave it further than this says.

    Args:
        robot: The robot.
        boxes: Shape (k, `ROUNDED_BOX`) [m, world].
        z: Coordinates, shape (nv,).
        cut: What is further away doesn't matter [m].
        least: Out: shape (k,) [m]; `cut` where it is at least that.
    """
    _place(robot, z)
    for k in range(boxes.shape[0]):
        box = boxes[k]
        least[k] = cut
        size = math.sqrt(box[12] ** 2 + box[13] ** 2 + box[14] ** 2) + box[15]
        for body in range(robot.carriers.shape[0]):
            pose, ball = robot.poses[robot.carriers[body]], robot.bounds[body]
            x, y, t = _point(pose, ball)
            reach = size + ball[3] + least[k]
            if (x - box[3]) ** 2 + (y - box[7]) ** 2 + (t - box[11]) ** 2 >= reach * reach:
                continue
            for i in range(robot.first[body], robot.first[body + 1]):
                ball = robot.balls[i]
                x, y, t = _point(pose, ball)
                least[k] = min(least[k], _distance(box, x, y, t)[0] - ball[3])


@compiled(float64(ROOM_ROBOT, MATRIX, VECTOR, SCALAR, VECTOR_OUT))
def pressure(robot: RoomRobot, boxes: Floats, z: Floats, cut: float, gradient: Floats) -> float:
    """How closely boxes surround a robot: the sum of (cut - d)^2 / 2 over balls and boxes that are closer than `cut`.

    Args:
        robot: The robot.
        boxes: Shape (k, `ROUNDED_BOX`) [m, world].
        z: Coordinates, shape (nv,).
        cut: From where on a box matters [m].
        gradient: Out: shape (nv,).

    Returns:
        The sum [m^2].
    """
    _place(robot, z)
    gradient[:] = 0.0
    whole = 0.0
    for k in range(boxes.shape[0]):
        box = boxes[k]
        size = math.sqrt(box[12] ** 2 + box[13] ** 2 + box[14] ** 2) + box[15]
        for body in range(robot.carriers.shape[0]):
            pose, ball = robot.poses[robot.carriers[body]], robot.bounds[body]
            x, y, t = _point(pose, ball)
            reach = size + ball[3] + cut
            if (x - box[3]) ** 2 + (y - box[7]) ** 2 + (t - box[11]) ** 2 >= reach * reach:
                continue
            for i in range(robot.first[body], robot.first[body + 1]):
                ball = robot.balls[i]
                x, y, t = _point(pose, ball)
                d, nx, ny, nz = _distance(box, x, y, t)
                lack = cut - (d - ball[3])
                if lack <= 0.0:
                    continue
                whole += 0.5 * lack * lack
                joint = robot.carriers[body]
                while joint > 0:
                    line = robot.lines[joint]
                    if robot.slides[joint] == 1:
                        rate = nx * line[0] + ny * line[1] + nz * line[2]
                    else:
                        px, py, pz = x - line[3], y - line[4], t - line[5]
                        rate = (
                            nx * (line[1] * pz - line[2] * py)
                            + ny * (line[2] * px - line[0] * pz)
                            + nz * (line[0] * py - line[1] * px)
                        )
                    gradient[robot.drivers[joint]] -= lack * rate * robot.multipliers[joint]
                    joint = robot.parents[joint]
    return whole


@lane_step(boolean(ROOM_ROBOT, MATRIX, VECTOR, VECTOR))
def blocked(robot: RoomRobot, boxes: Floats, grown: Floats, z: Floats) -> bool:
    """Whether the robot comes closer to any box than it is to keep.

    Args:
        robot: The robot.
        boxes: Shape (k, `ROUNDED_BOX`) [m, world].
        grown: What to keep from each, shape (k,) [m].
        z: Coordinates, shape (nv,).
    """
    _place(robot, z)
    for body in range(robot.carriers.shape[0]):
        pose, ball = robot.poses[robot.carriers[body]], robot.bounds[body]
        x, y, t = _point(pose, ball)
        for k in range(boxes.shape[0]):
            box = boxes[k]
            size = math.sqrt(box[12] ** 2 + box[13] ** 2 + box[14] ** 2) + box[15]
            reach = size + ball[3] + grown[k]
            away = (x - box[3]) ** 2 + (y - box[7]) ** 2 + (t - box[11]) ** 2
            if reach <= 0.0 or away >= reach * reach or _distance(box, x, y, t)[0] >= ball[3] + grown[k]:
                continue
            for i in range(robot.first[body], robot.first[body + 1]):
                u, v, w = _point(pose, robot.balls[i])
                if _distance(box, u, v, w)[0] - robot.balls[i, 3] < grown[k]:
                    return True
    return False


@compiled(float64(ROOM_ROBOT, VECTOR, SCALAR))
def swept(robot: RoomRobot, z: Floats, tolerance: float) -> float:
    """How far the point of the robot that moves furthest is moved where each coordinate is off by a tolerance [m].

    Args:
        robot: The robot.
        z: Coordinates, shape (nv,).
        tolerance: How far each may be off [rad or m].
    """
    _place(robot, z)
    most = 0.0
    for body in range(robot.carriers.shape[0]):
        joint, ball = robot.carriers[body], robot.bounds[body]
        x, y, t = _point(robot.poses[joint], ball)
        whole = 0.0
        while joint > 0:
            line, off = robot.lines[joint], abs(robot.multipliers[joint]) * tolerance
            if robot.slides[joint] == 1:
                whole += off
            else:
                px, py, pz = x - line[3], y - line[4], t - line[5]
                cx, cy, cz = py * line[2] - pz * line[1], pz * line[0] - px * line[2], px * line[1] - py * line[0]
                far = math.sqrt(cx * cx + cy * cy + cz * cz) + ball[3]
                whole += 2.0 * math.sin(0.5 * min(off, math.pi)) * far
            joint = robot.parents[joint]
        most = max(most, whole)
    return most


def nearest(robot: RoomRobot, boxes: Floats, z: Floats, cut: float) -> Floats:
    """`distances` in an array of their own, shape (k,) [m]."""
    least = np.empty(len(boxes))
    distances(robot, boxes, z, cut, least)
    return least
