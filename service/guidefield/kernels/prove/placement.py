"""Placements of a robot and of moving obstacles at a parameter of a motion, joint twists, bounds of Bezier segments.

Placements are numbered (`PLACEMENT`), so that each moving obstacle is placed once for each. `step_at` and the screws of
`place_mover` have to agree with the trajectories that `prove/tables.py` makes; the referee has code of its own.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from guidefield.kernels.jit.arrays import Blocks, BlocksOut, Floats, RowsOut, Vector3
from guidefield.kernels.jit.decorators import uncounted, vector_kernel
from guidefield.kernels.kinematics.forward_kinematics import place_by_local, place_subspaces, subspaces_by_local
from guidefield.kernels.kinematics.poses import moved_by
from guidefield.kernels.prove.tables import BezierCurve, MovingObstacles, MovingRobot, RobotBodies

MOST_ORDER = 8  # control points of a piece of a curve, at most: the size of scratch, which nothing checks


@uncounted
def piece_at(curve: BezierCurve, at: float) -> int:
    """Return the piece at a parameter: at a knot the one that begins there."""
    low, high = 0, curve.times.shape[0] - 1
    while high - low > 1:
        middle = (low + high) // 2
        if curve.times[middle] <= at:
            low = middle
        else:
            high = middle
    return low


@uncounted
def share_at(curve: BezierCurve, piece: int, at: float) -> float:
    """Return the share of a piece that has passed at a parameter, from 0 to 1."""
    span = curve.times[piece + 1] - curve.times[piece]
    return min(max((at - curve.times[piece]) / span, 0.0), 1.0) if span > 0.0 else 0.0


@uncounted
def _write_blossom(
    controls: Floats, piece: int, low: float, high: float, highs: int, weights: Floats, point_out: Floats
) -> None:
    """Write the blossom of a Bezier curve at `highs` times the parameter `high`, and else `low`.

    With the parameters s it is the sum of the control points by the coefficients of the product of all 1 - s + s x,
    sorted by powers of x.
    """
    order = controls.shape[1]
    weights[0] = 1.0
    for taken in range(1, order):
        s = high if taken <= highs else low
        weights[taken] = s * weights[taken - 1]
        for power in range(taken - 1, 0, -1):
            weights[power] = (1.0 - s) * weights[power] + s * weights[power - 1]
        weights[0] *= 1.0 - s
    for j in range(point_out.shape[0]):
        point_out[j] = weights[0] * controls[piece, 0, j]
    for i in range(1, order):
        for j in range(point_out.shape[0]):
            point_out[j] += weights[i] * controls[piece, i, j]


@uncounted
def write_point(curve: BezierCurve, at: float, weights: Floats, point_out: Floats) -> None:
    """Write the point of a motion at a parameter; scratch of shape (MOST_ORDER,)."""
    piece = piece_at(curve, at)
    _write_blossom(curve.positions, piece, share_at(curve, piece, at), 0.0, 0, weights, point_out)


@uncounted
def _write_part(controls: Floats, piece: int, low: float, high: float, weights: Floats, part_out: Floats) -> None:
    """Write the control points of the part of a Bezier curve between two parameters from 0 to 1."""
    for index in range(controls.shape[1]):
        _write_blossom(controls, piece, low, high, index, weights, part_out[index])


@uncounted
def _widen(
    control: Floats, along: float, middle: Floats, chord: Floats, tube: Floats, farthest: Floats, aside: Floats
) -> None:
    """Widen bounds of a motion about its middle by a control point whose l is known; see `bound_segment`."""
    for j in range(middle.shape[0]):
        x = control[j] - middle[j]
        farthest[j] = max(farthest[j], abs(x) + tube[j])
        aside[j] = max(aside[j], abs(x - along * chord[j]) + tube[j])


@uncounted
def _along(control: Floats, middle: Floats, chord: Floats, per_square: float) -> float:
    """Return the l of the point on the line along a chord that is nearest to a control point."""
    along = 0.0
    for j in range(middle.shape[0]):
        along += (control[j] - middle[j]) * chord[j]
    return along * per_square


@uncounted
def time_at(curve: BezierCurve, at: float) -> float:
    """Return the time at a parameter [s]."""
    piece = piece_at(curve, at)
    return float(curve.clock[piece] + share_at(curve, piece, at) * (curve.clock[piece + 1] - curve.clock[piece]))


@uncounted
def bound_segment(
    curve: BezierCurve,
    since: float,
    until: float,
    now: float,
    timed: bool,
    middle: Floats,
    weights: Floats,
    parts: Floats,
    chord_out: Floats,
    farthest_out: Floats,
    aside_out: Floats,
    tube_out: Floats,
) -> float:
    """Bound a motion between two parameters about `middle` (nv,): x = l D + e, with D the chord.

    Return the most of |l|. Control points of the part of each piece in between are no nearer. Where obstacles move,
    `timed`, l is the share of the time that has passed since the place, so that both go on together; else that of the
    nearest point along D. Writes D, the most of each coordinate of x and of e (nv,), both with what the robot may be
    beside the curve, and the most of that; scratch (MOST_ORDER,) and (2, MOST_ORDER, nv).
    """
    controls, order, nv = curve.positions, curve.positions.shape[1], curve.positions.shape[2]
    first, last = piece_at(curve, since), piece_at(curve, until)
    if last > first and until <= curve.times[last]:  # the one that begins there doesn't count: curves may jump
        last -= 1
    for side in range(2 if last > first else 1):
        piece = first if side == 0 else last
        low, high = share_at(curve, piece, since), share_at(curve, piece, until)
        _write_part(controls, piece, low, high, weights, parts[side])
    final = 1 if last > first else 0
    square, share = 0.0, 0.0
    for j in range(nv):
        chord_out[j] = parts[final, order - 1, j] - parts[0, 0, j]
        square += chord_out[j] ** 2
        farthest_out[j], aside_out[j], tube_out[j] = 0.0, 0.0, 0.0
    per_square = 1.0 / square if square > 0.0 else 0.0
    begins, ends = time_at(curve, since), time_at(curve, until)
    timed = timed and ends > begins
    per_second = 1.0 / (ends - begins) if timed else 0.0
    for piece in range(first, last + 1):
        at_end = piece in (first, last)
        begin, end = curve.clock[piece], curve.clock[piece + 1]
        if piece == first:
            begin = begins
        if piece == last:
            end = ends
        for index in range(order):
            control = parts[0 if piece == first else final, index] if at_end else controls[piece, index]
            along = _along(control, middle, chord_out, per_square)
            if timed:  # in a piece time is the curve of degree 1 whose control points are even
                along = (begin + (end - begin) * index / (order - 1) - now) * per_second
            share = max(share, abs(along))
            _widen(control, along, middle, chord_out, curve.tube[piece], farthest_out, aside_out)
        for j in range(nv):
            tube_out[j] = max(tube_out[j], curve.tube[piece, j])
    return share


@vector_kernel
def find_halves(curves: Blocks, halves: BlocksOut) -> None:
    """Write both halves (2 n, k, nv) of each Bezier curve (n, k, nv), in order."""
    count, order, nv = curves.shape
    for curve in range(count):
        first, second = halves[2 * curve], halves[2 * curve + 1]
        for at in range(order):
            for i in range(nv):
                second[at, i] = curves[curve, at, i]
        for step in range(order):
            for i in range(nv):
                first[step, i] = second[0, i]
            for at in range(order - 1 - step):  # what is behind them is the second half already
                for i in range(nv):
                    second[at, i] = 0.5 * (second[at, i] + second[at + 1, i])


@vector_kernel
def find_ranges(curves: Blocks, low: RowsOut, high: RowsOut) -> None:
    """Write the least and the largest value (n, nv) of each coordinate of each curve's control points (n, k, nv)."""
    count, order, nv = curves.shape
    for curve in range(count):
        for i in range(nv):
            low[curve, i] = high[curve, i] = curves[curve, 0, i]
        for at in range(1, order):
            for i in range(nv):
                low[curve, i] = min(low[curve, i], curves[curve, at, i])
                high[curve, i] = max(high[curve, i], curves[curve, at, i])


TWIST = 6  # numbers of a twist
SMALL_ANGLE = 1e-4  # below [rad] series stand for sine and cosine, as exact as rounding; much more or less loses digits

NOW, PLACEMENT, MOMENT = range(3)
"""Numbers of a moment: the time [s] and the number of the placement; then how many there are."""


class BodyPoses(NamedTuple):
    """A robot at a parameter, and obstacles that move then; overwritten by the next placement."""

    poses: Floats  # of the joints, shape (joints, 3, 4) [m]
    centres: Floats  # of the balls about bodies, shape (r, 3) [m, world]
    subspaces: Floats  # the joints' motion subspaces, shape (n, TWIST)
    twists: Floats  # motion by each coordinate of the model as that changes, shape (n, TWIST) [m and rad, world]
    moment: Floats  # shape (MOMENT,)
    mover_poses: Floats  # motion of each moving obstacle from where it is at first, shape (v, 12) [m, world]
    mover_placements: Floats  # number of the placement for which each pose is known, shape (v,)


class PoseScratch(NamedTuple):
    """Scratch of `place_at`."""

    weights: Floats  # shape (MOST_ORDER,)
    # z, straight: Local coordinates of the group, and the chord of a segment, shape (nv,)
    z: Floats
    straight: Floats
    # values, changes: The same of the model, shape (n,)
    values: Floats
    changes: Floats
    q: Floats  # configuration of the model, shape (nq,)
    # rotation, translation: Of a joint, shapes (3, 3) and (3,)
    rotation: Floats
    translation: Floats


@uncounted
def place_at(moving: MovingRobot, at: float, place: BodyPoses, scratch: PoseScratch) -> None:
    """Place the robot at a parameter of its motion: poses and centres of `place` are written."""
    robot = moving.robot
    write_point(moving.curve, at, scratch.weights, scratch.z)
    for i in range(robot.offset.shape[0]):
        value = robot.offset[i]
        for j in range(scratch.z.shape[0]):
            value += robot.expand[i, j] * scratch.z[j]
        scratch.values[i] = value
    place_by_local(
        robot.joints, scratch.values, robot.origin, scratch.q, scratch.rotation, scratch.translation, place.poses
    )
    place_centres(robot, place)
    place.moment[NOW] = time_at(moving.curve, at)
    place.moment[PLACEMENT] += 1.0


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
def kept_from_mover(movers: MovingObstacles, mover: int, time: float) -> float:
    """Return the additional distance kept from a moving obstacle at a time [s], as it may have left its motion [m]."""
    return float(movers.margins[mover] + movers.growths[mover] * max(time - movers.since[mover], 0.0))


@uncounted
def place_mover(movers: MovingObstacles, mover: int, place: BodyPoses) -> None:
    """Place a moving obstacle at the moment of a placement, once: exp((t - t_k) twist_k) times its pose at step k."""
    if place.mover_placements[mover] == place.moment[PLACEMENT]:
        return
    place.mover_placements[mover] = place.moment[PLACEMENT]
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
    for b in range(robot.parent_joints.shape[0]):
        pose = place.poses[robot.parent_joints[b]]
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
    subspaces_by_local(joints, scratch.values, scratch.q, place.twists)
    for i in range(scratch.changes.shape[0]):
        for k in range(TWIST):
            place.twists[i, k] *= scratch.changes[i]
