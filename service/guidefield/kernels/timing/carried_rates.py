"""Largest speed and acceleration of points that a joint carries along a motion, and bounds of them between samples.

Let x1 to x4 bound the first four derivatives of the local coordinates on an interval, joint by joint from the root
on, and R the distance of the point from each joint's axis; 1 for a slide. A derivative of the point's position by
several coordinates is no longer than R of the last of these: the axes of the earlier ones turn the column of the later
one, or are turned. So with X = x_1 + ... + x_k up to a joint, and D its change at that joint,

    |p''|  <= sum R (x2 + D(X1²))
    |p'''| <= sum R (x3 + 3 D(X1 X2) + D(X1³))
    |p''''| <= sum R (x4 + D(4 X1 X3 + 3 X2² + 6 X1² X2 + X1⁴))

R grows by at most what the joints after it move the point. Over a time h a vector is within h²/8 times the bound of its
second derivative from the chord, whose length is largest at an end. Limits of speeds in space rest on these bounds,
which hold whatever the constants are; docs/certificate.md promises them within 0.1 %, for which those must suffice.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from guidefield.kernels.jit.arrays import Blocks, Floats, Row, RowOut, Rows, RowsOut
from guidefield.kernels.jit.decorators import counted, kernel, uncounted
from guidefield.kernels.kinematics.forward_kinematics import (
    CONTINUOUS,
    PLANAR,
    REVOLUTE,
    GroupJoints,
    JointPlaces,
    JointTable,
    joint_places,
    place_group,
    velocity_by,
    write_twists,
)
from guidefield.kernels.kinematics.poses import moved_by

FOUND, BOUND, TIME = range(3)  # columns of the result for a quantity: the largest found, a bound of it, when
SHORTEST = 2.0**-40  # share of a piece below which intervals aren't halved any more
HALVINGS = 200_000  # of intervals of a motion, at most: what is found may be rounding alone, and no bound close to it


class CarriedBody(NamedTuple):
    """Points, or balls, that a joint carries, of which the fastest counts."""

    joints: GroupJoints  # those that lead to the parent joint, which is the last; none is a ball or a floating joint
    points: Rows  # in its frame, shape (n, 3) [m]
    radii: Row  # of balls about them, shape (n,) [m]
    centre: Row  # of a ball that holds all of them, shape (3,) [m]
    radius: float  # its radius [m]


class MotionPolynomials(NamedTuple):
    """A motion in time, piece by piece: positions are continuous, rates may jump at knots."""

    times: Row  # begin of each piece, and the end of the last one, shape (m + 1,), increasing strictly [s]
    powers: Blocks  # coefficients by powers of the time since a piece begins, shape (m, k, nv)


class CoordinateBounds(NamedTuple):
    """A motion's local coordinates and rates at a time, and bounds until another, by coordinate of the model: (m,)."""

    z: RowOut  # of the group, shape (nv,) [rad or m]
    dz: RowOut
    ddz: RowOut
    first: RowOut  # magnitudes of the first four derivatives, at most
    second: RowOut
    third: RowOut
    fourth: RowOut


@counted
def empty_bounds(nv: int, rows: int) -> CoordinateBounds:
    """Return scratch for nv coordinates of a group, and `rows` of its model."""
    return CoordinateBounds(
        np.empty(nv), np.empty(nv), np.empty(nv), np.empty(rows), np.empty(rows), np.empty(rows), np.empty(rows)
    )


@uncounted
def write_state(motion: MotionPolynomials, piece: int, t: float, state: CoordinateBounds) -> None:
    """Write the group's coordinates and their first two derivatives at a time in a piece."""
    order = motion.powers.shape[1]
    for j in range(state.z.shape[0]):
        z = dz = half = 0.0
        for power in range(order - 1, -1, -1):
            half = half * t + dz
            dz = dz * t + z
            z = z * t + motion.powers[piece, power, j]
        state.z[j], state.dz[j], state.ddz[j] = z, dz, 2.0 * half


@uncounted
def bound_rates(
    joints: GroupJoints, motion: MotionPolynomials, piece: int, since: float, until: float, state: CoordinateBounds
) -> None:
    """Bound the derivatives of the model's coordinates between two times in a piece, by those in the middle."""
    middle, half, order = 0.5 * (since + until), 0.5 * (until - since), motion.powers.shape[1]
    for i in range(joints.sources.shape[0]):
        j, by = joints.sources[i], abs(joints.multipliers[i])
        state.first[i] = state.second[i] = state.third[i] = state.fourth[i] = 0.0
        factorial = 1.0
        for n in range(1, order):
            factorial *= n
            here, choose, rest = 0.0, 1.0, 1.0
            for power in range(n, order):  # the n-th derivative by n!: with binomials, and powers of the time
                here += choose * motion.powers[piece, power, j] * rest
                choose *= (power + 1.0) / (power + 1.0 - n)
                rest *= middle
            part = by * factorial * abs(here)  # in the k-th derivative it counts with (h / 2)^(n - k) / (n - k)!
            for k in range(n, 0, -1):
                if k == 1:
                    state.first[i] += part
                elif k == 2:
                    state.second[i] += part
                elif k == 3:
                    state.third[i] += part
                elif k == 4:
                    state.fourth[i] += part
                part *= half / (n - k + 1.0)


@uncounted
def turns_by(table: JointTable, joint: int, k: int) -> bool:
    """Tell if a coordinate of a joint, by its number, is an angle."""
    kind = table.kinds[joint]
    return bool(kind in (REVOLUTE, CONTINUOUS) or (kind == PLANAR and k == 2))


@uncounted
def add_twists(
    joints: GroupJoints, joint: int, state: CoordinateBounds, places: JointPlaces, twist: Floats, change: Floats
) -> None:
    """Add to a twist (6,) at the world's origin, and to its derivative by time, what a joint adds."""
    table = joints.table
    for row in range(table.idx_v[joint], table.idx_v[joint] + table.nv[joint]):
        source, by, s = joints.sources[row], joints.multipliers[row], places.twists[row]
        rate, rise = by * state.dz[source], by * state.ddz[source]
        vx, vy, vz, wx, wy, wz = twist[0], twist[1], twist[2], twist[3], twist[4], twist[5]
        change[0] += s[0] * rise + rate * (wy * s[2] - wz * s[1] + vy * s[5] - vz * s[4])
        change[1] += s[1] * rise + rate * (wz * s[0] - wx * s[2] + vz * s[3] - vx * s[5])
        change[2] += s[2] * rise + rate * (wx * s[1] - wy * s[0] + vx * s[4] - vy * s[3])
        change[3] += s[3] * rise + rate * (wy * s[5] - wz * s[4])
        change[4] += s[4] * rise + rate * (wz * s[3] - wx * s[5])
        change[5] += s[5] * rise + rate * (wx * s[4] - wy * s[3])
        for k in range(6):
            twist[k] += s[k] * rate


@uncounted
def _norm(x: float, y: float, z: float) -> float:
    return math.sqrt(x * x + y * y + z * z)


@uncounted
def _rates_of(
    body: CarriedBody, state: CoordinateBounds, places: JointPlaces, twists: Floats, radii_out: Floats
) -> tuple[float, float]:
    """Return the largest speed and acceleration of the points; write R by the chain's rows.

    Scratch (3, 6) begins with the twist and its derivative; last are velocity and acceleration of the fastest point.
    """
    joints, table = body.joints, body.joints.table
    last = table.parents.shape[0] - 1
    place_group(joints, state.z, places)
    write_twists(joints, places)
    twists[:, :] = 0.0
    twist, change = twists[0], twists[1]
    pose = places.poses[last]
    cx, cy, cz = moved_by(pose, body.centre[0], body.centre[1], body.centre[2])
    for i in range(1, last + 1):
        add_twists(joints, i, state, places, twist, change)
        for k in range(table.nv[i]):
            row = table.idx_v[i] + k
            vx, vy, vz = velocity_by(places.twists[row], cx, cy, cz)
            radii_out[row] = _norm(vx, vy, vz) + body.radius if turns_by(table, i, k) else 1.0
    # at the parent joint's origin, in the world's axes
    ox, oy, oz = pose[0, 3], pose[1, 3], pose[2, 3]
    vx, vy, vz = velocity_by(twist, ox, oy, oz)
    ax, ay, az = velocity_by(change, ox, oy, oz)
    wx, wy, wz = twist[3], twist[4], twist[5]
    ax, ay, az = ax + wy * vz - wz * vy, ay + wz * vx - wx * vz, az + wx * vy - wy * vx
    turning, swinging = _norm(wx, wy, wz), _norm(change[3], change[4], change[5])
    speed = acceleration = 0.0
    for k in range(body.points.shape[0]):
        p = body.points[k]
        x = pose[0, 0] * p[0] + pose[0, 1] * p[1] + pose[0, 2] * p[2]
        y = pose[1, 0] * p[0] + pose[1, 1] * p[1] + pose[1, 2] * p[2]
        z = pose[2, 0] * p[0] + pose[2, 1] * p[1] + pose[2, 2] * p[2]
        rx, ry, rz = wy * z - wz * y, wz * x - wx * z, wx * y - wy * x
        at_middle = _norm(vx + rx, vy + ry, vz + rz)
        is_fastest = k == 0 or at_middle + body.radii[k] * turning > speed
        speed = max(speed, at_middle + body.radii[k] * turning)
        bx = ax + change[4] * z - change[5] * y + wy * rz - wz * ry
        by = ay + change[5] * x - change[3] * z + wz * rx - wx * rz
        bz = az + change[3] * y - change[4] * x + wx * ry - wy * rx
        acceleration = max(acceleration, _norm(bx, by, bz) + body.radii[k] * (swinging + turning * turning))
        if is_fastest:
            fastest = twists[2]
            fastest[0], fastest[1], fastest[2] = vx + rx, vy + ry, vz + rz
            fastest[3], fastest[4], fastest[5] = bx, by, bz
    return speed, acceleration


@uncounted
def _bounds_of(body: CarriedBody, span: float, state: CoordinateBounds, radii: Floats) -> tuple[float, float]:
    """Bound the third and the fourth derivative of the points' positions for a time from where `radii` were found."""
    table = body.joints.table
    moved = 0.0
    third = fourth = 0.0
    for i in range(table.parents.shape[0] - 1, 0, -1):
        for k in range(table.nv[i] - 1, -1, -1):
            row = table.idx_v[i] + k
            reach = radii[row] + moved if turns_by(table, i, k) else 1.0
            moved += span * state.first[row] * reach
            x1 = x2 = x3 = 0.0  # up to the joint before
            for h in range(1, i + 1):
                for n in range(table.nv[h] if h < i else k):
                    x1 += state.first[table.idx_v[h] + n]
                    x2 += state.second[table.idx_v[h] + n]
                    x3 += state.third[table.idx_v[h] + n]
            y1, y2, y3 = x1 + state.first[row], x2 + state.second[row], x3 + state.third[row]
            third += reach * (state.third[row] + 3.0 * (y1 * y2 - x1 * x2) + y1**3 - x1**3)
            fourth += reach * (
                state.fourth[row]
                + 4.0 * (y1 * y3 - x1 * x3)
                + 3.0 * (y2 * y2 - x2 * x2)
                + 6.0 * (y1 * y1 * y2 - x1 * x1 * x2)
                + y1**4
                - x1**4
            )
    return third, fourth


@kernel
def largest_point_rates(
    body: CarriedBody, motion: MotionPolynomials, share: float, counts_acceleration: bool, found_out: RowsOut
) -> None:
    """Write the largest speed and acceleration of a body's points along a motion, (2, 3): see `FOUND`.

    Intervals are halved, `HALVINGS` times at most, until the bounds are no more than a share above what is found.
    Without `counts_acceleration` that isn't bounded.
    """
    times, nv = motion.times, motion.powers.shape[2]
    joints, rows = body.joints, body.joints.sources.shape[0]
    places, twists, radii, next_radii = joint_places(joints), np.zeros((3, 6)), np.zeros(rows), np.zeros(rows)
    state = empty_bounds(nv, rows)
    found_out[:, :] = 0.0
    pieces, halved = times.shape[0] - 1, 0
    for piece in range(pieces):
        for half in range(3):
            t = 0.5 * half * (times[piece + 1] - times[piece])
            write_state(motion, piece, t, state)
            speed, acceleration = _rates_of(body, state, places, twists, radii)
            if speed > found_out[0, FOUND]:
                found_out[0, FOUND], found_out[0, TIME] = speed, times[piece] + t
            if acceleration > found_out[1, FOUND]:
                found_out[1, FOUND], found_out[1, TIME] = acceleration, times[piece] + t
    found_out[0, BOUND], found_out[1, BOUND] = found_out[0, FOUND], found_out[1, FOUND]
    for piece in range(pieces):
        length = times[piece + 1] - times[piece]
        since, step = 0.0, length
        write_state(motion, piece, 0.0, state)
        speed, acceleration = _rates_of(body, state, places, twists, radii)
        while since < length:
            step = min(step, length - since)
            until = length if since + step >= length else since + step
            bound_rates(joints, motion, piece, since, until, state)
            third, fourth = _bounds_of(body, step, state, radii)
            write_state(motion, piece, until, state)
            next_speed, next_acceleration = _rates_of(body, state, places, twists, next_radii)
            if next_speed > found_out[0, FOUND]:
                found_out[0, FOUND], found_out[0, TIME] = next_speed, times[piece] + until
            if next_acceleration > found_out[1, FOUND]:
                found_out[1, FOUND], found_out[1, TIME] = next_acceleration, times[piece] + until
            most_speed = max(speed, next_speed) + step * step / 8.0 * third
            most_acceleration = max(acceleration, next_acceleration) + step * step / 8.0 * fourth
            is_close = most_speed <= (1.0 + share) * found_out[0, FOUND]
            if counts_acceleration and most_acceleration > (1.0 + share) * found_out[1, FOUND]:
                is_close = False
            if not is_close and step > SHORTEST * length and halved < HALVINGS:
                step *= 0.5
                halved += 1
                continue
            found_out[0, BOUND] = max(found_out[0, BOUND], most_speed)
            found_out[1, BOUND] = max(found_out[1, BOUND], most_acceleration)
            speed, acceleration, since = next_speed, next_acceleration, until
            radii[:] = next_radii
            step *= 2.0


@kernel
def fastest_points(
    body: CarriedBody,
    zs: Rows,
    first: Rows,
    second: Rows,
    speeds_out: RowOut,
    velocities_out: RowsOut,
    bends_out: RowsOut,
) -> None:
    """Write speed (g,), velocity and acceleration (g, 3) of a body's fastest point where z, z' and z'' are (g, nv)."""
    joints, rows, nv = body.joints, body.joints.sources.shape[0], zs.shape[1]
    places, twists, radii = joint_places(joints), np.zeros((3, 6)), np.zeros(rows)
    state = empty_bounds(nv, rows)
    for g in range(zs.shape[0]):
        state.z[:], state.dz[:], state.ddz[:] = zs[g], first[g], second[g]
        speeds_out[g], _ = _rates_of(body, state, places, twists, radii)
        for k in range(3):
            velocities_out[g, k], bends_out[g, k] = twists[2, k], twists[2, 3 + k]
