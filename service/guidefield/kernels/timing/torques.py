"""Torques along a motion, and bounds of them between samples: inverse dynamics of a tree of bodies.

By d'Alembert's principle what drives coordinate i is the integral over all mass of J_i · (p'' - g), with J_i = dp/dz_i.
Its second derivative by time is at most that of

    |J_i''| |p'' - g| + 2 |J_i'| |p'''| + |J_i| |p''''|,

whose factors `carried_rates` bounds by distances R from the axes, each linear in R. Over a body R is at most that of
its centre of mass plus the distance from there; so the integral of a product of two factors is at most its mass times
their product with the root of the mean square of that distance (Cauchy and Schwarz). What a point of mass
has by the joints up to one, with X their sums and D their changes, is

    |J_i|   <= R_i
    |J_i'|  <= R_i X1_i + sum over later joints R x1
    |J_i''| <= R_i (X2_i + X1_i²) + sum over later joints R (x2 + D(X1²))

Limits of torques rest on these bounds (`planner/task/effort.py`): they hold whatever `CLOSER`, `HALVINGS` and
`EXCESS` are. But docs/motions.md and replies promise them within 1 %, docs/certificate.md within 1e-4 at a limit: for
that `HALVINGS` must suffice and `EXCESS` not grow. With more of `SAME` jumps of torques at knots are overlooked.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from guidefield.kernels.jit.arrays import Blocks, Floats, IndexRows, Row, RowOut, Rows, RowsOut
from guidefield.kernels.jit.decorators import counted, kernel, uncounted
from guidefield.kernels.kinematics.forward_kinematics import (
    GroupJoints,
    JointPlaces,
    joint_places,
    place_group,
    velocity_by,
    write_twists,
)
from guidefield.kernels.kinematics.poses import moved_by, turned_by
from guidefield.kernels.timing.carried_rates import (
    BOUND,
    FOUND,
    SHORTEST,
    TIME,
    CoordinateBounds,
    MotionPolynomials,
    add_twists,
    bound_rates,
    empty_bounds,
    write_state,
)

SAME = 1e-9  # share by which rates may differ that are the same but for rounding
CLOSER = 0.1  # share of a piece below which an interval has bounds of its own
HALVINGS = 20_000  # of intervals, at most, as in `carried_rates`: fewer, as each takes longer
EXCESS = 1e-4  # share of what is found that its bound may always be above it: it matters where a limit isn't kept


class MassTree(NamedTuple):
    """The bodies of a robot's model, by the joint that carries each; none is carried by a ball or floating joint."""

    joints: GroupJoints
    masses: Row  # shape (n,); that of the world doesn't count [kg]
    centres: Rows  # centres of mass in the joints' frames, shape (n, 3) [m]
    inertias: Blocks  # about these, in the joints' axes, shape (n, 3, 3) [kg m²]
    spreads: Row  # root of the mean square of the distance from the centre of mass, shape (n,) [m]
    # coordinates of the model that move each body, from the root on, shape (n, m), then -1; and which are angles: 1
    chains: IndexRows
    turns: IndexRows
    gravity: Row  # acceleration of free fall, shape (3,) [m/s²]


class TorqueBuffers(NamedTuple):
    """Buffers of inverse dynamics and its bounds; n joints, at the world's origin."""

    twists: RowsOut  # of joints, shape (n, 6)
    changes: RowsOut  # their derivatives by time, less gravity, shape (n, 6)
    wrenches: RowsOut  # of bodies, then of all that each joint carries, shape (n, 6)
    torques: RowOut  # shape (nv,)
    reaches: RowOut  # R of one body, by its chain
    sums: RowsOut  # of bounds up to each entry of that chain, shape (chain, 4)
    bounds: RowOut  # of the torques' second derivatives, shape (nv,)


@counted
def allocate_torque_buffers(n: int, nv: int, chain: int) -> TorqueBuffers:
    """Allocate the buffers for n joints, nv coordinates of the group, and chains of a length."""
    return TorqueBuffers(
        np.empty((n, 6)),
        np.empty((n, 6)),
        np.empty((n, 6)),
        np.empty(nv),
        np.empty(chain),
        np.empty((chain, 4)),
        np.empty(nv),
    )


@uncounted
def place_tree(tree: MassTree, state: CoordinateBounds, places: JointPlaces) -> None:
    """Place the joints, and their twists, at the state's coordinates."""
    place_group(tree.joints, state.z, places)
    write_twists(tree.joints, places)


@uncounted
def write_torques(
    tree: MassTree, state: CoordinateBounds, places: JointPlaces, buffers: TorqueBuffers, torques_out: Floats
) -> None:
    """Write the torques of the group's coordinates (nv,) where the joints are placed, at the state's rates."""
    joints, table = tree.joints, tree.joints.table
    n = table.parents.shape[0]
    for k in range(6):
        buffers.twists[0, k], buffers.changes[0, k] = 0.0, -tree.gravity[k] if k < 3 else 0.0
    for i in range(1, n):
        twist, change, wrench, pose = buffers.twists[i], buffers.changes[i], buffers.wrenches[i], places.poses[i]
        for k in range(6):
            twist[k], change[k] = buffers.twists[table.parents[i], k], buffers.changes[table.parents[i], k]
        add_twists(joints, i, state, places, twist, change)
        mass, centre = tree.masses[i], tree.centres[i]
        cx, cy, cz = moved_by(pose, centre[0], centre[1], centre[2])
        wx, wy, wz = twist[3], twist[4], twist[5]
        vx, vy, vz = velocity_by(twist, cx, cy, cz)
        ax, ay, az = velocity_by(change, cx, cy, cz)
        fx, fy, fz = mass * (ax + wy * vz - wz * vy), mass * (ay + wz * vx - wx * vz), mass * (az + wx * vy - wy * vx)
        # the moment about the centre, I w' + w x I w, in the joint's axes and then in the world's
        ux, uy, uz = _turn_back(pose, wx, wy, wz)
        dx, dy, dz = _turn_back(pose, change[3], change[4], change[5])
        hx, hy, hz = _times(tree.inertias[i], ux, uy, uz)
        mx, my, mz = _times(tree.inertias[i], dx, dy, dz)
        mx, my, mz = mx + uy * hz - uz * hy, my + uz * hx - ux * hz, mz + ux * hy - uy * hx
        mx, my, mz = turned_by(pose, mx, my, mz)
        wrench[0], wrench[1], wrench[2] = fx, fy, fz
        wrench[3], wrench[4], wrench[5] = mx + cy * fz - cz * fy, my + cz * fx - cx * fz, mz + cx * fy - cy * fx
    torques_out[:] = 0.0
    for i in range(n - 1, 0, -1):
        for row in range(table.idx_v[i], table.idx_v[i] + table.nv[i]):
            torque = 0.0
            for k in range(6):
                torque += places.twists[row, k] * buffers.wrenches[i, k]
            torques_out[joints.sources[row]] += joints.multipliers[row] * torque
        parent = table.parents[i]
        if parent > 0:
            for k in range(6):
                buffers.wrenches[parent, k] += buffers.wrenches[i, k]


@uncounted
def write_radii(tree: MassTree, places: JointPlaces, radii_out: Floats) -> None:
    """Write R of the bodies where the joints are placed, by the chains' entries, shape (n, m) [m]."""
    for i in range(1, tree.masses.shape[0]):
        centre = tree.centres[i]
        x, y, z = moved_by(places.poses[i], centre[0], centre[1], centre[2])
        for c in range(tree.chains.shape[1]):
            row = tree.chains[i, c]
            if row < 0:
                break
            if tree.turns[i, c] == 1:
                rx, ry, rz = velocity_by(places.twists[row], x, y, z)
                radii_out[i, c] = math.sqrt(rx * rx + ry * ry + rz * rz) + tree.spreads[i]
            else:
                radii_out[i, c] = 1.0


@uncounted
def _turn_back(T: Floats, x: float, y: float, z: float) -> tuple[float, float, float]:
    """An axis of the world in a placed frame."""
    return (
        T[0, 0] * x + T[1, 0] * y + T[2, 0] * z,
        T[0, 1] * x + T[1, 1] * y + T[2, 1] * z,
        T[0, 2] * x + T[1, 2] * y + T[2, 2] * z,
    )


@uncounted
def _times(M: Floats, x: float, y: float, z: float) -> tuple[float, float, float]:
    return (
        M[0, 0] * x + M[0, 1] * y + M[0, 2] * z,
        M[1, 0] * x + M[1, 1] * y + M[1, 2] * z,
        M[2, 0] * x + M[2, 1] * y + M[2, 2] * z,
    )


@uncounted
def _write_bounds(tree: MassTree, span: float, state: CoordinateBounds, radii: Floats, buffers: TorqueBuffers) -> None:
    """Write bounds of the second derivatives of the group's torques for a time from where `radii` were found."""
    joints, weight = tree.joints, 0.0
    for k in range(3):
        weight += tree.gravity[k] ** 2
    weight = math.sqrt(weight)
    buffers.bounds[:] = 0.0
    reaches, sums = buffers.reaches, buffers.sums
    for i in range(1, tree.masses.shape[0]):
        mass = tree.masses[i]
        count = 0
        while count < tree.chains.shape[1] and tree.chains[i, count] >= 0:
            count += 1
        if mass <= 0.0 or count == 0:
            continue
        moved = 0.0
        for c in range(count - 1, -1, -1):
            reaches[c] = radii[i, c] + moved if tree.turns[i, c] == 1 else 1.0
            moved += span * state.first[tree.chains[i, c]] * reaches[c]
        second, third, fourth = weight, 0.0, 0.0
        x1 = x2 = x3 = 0.0
        for c in range(count):
            row, reach = tree.chains[i, c], reaches[c]
            y1, y2, y3 = x1 + state.first[row], x2 + state.second[row], x3 + state.third[row]
            square = y1 * y1 - x1 * x1
            second += reach * (state.second[row] + square)
            third += reach * (state.third[row] + 3.0 * (y1 * y2 - x1 * x2) + y1**3 - x1**3)
            fourth += reach * (
                state.fourth[row]
                + 4.0 * (y1 * y3 - x1 * x3)
                + 3.0 * (y2 * y2 - x2 * x2)
                + 6.0 * (y1 * y1 * y2 - x1 * x1 * x2)
                + y1**4
                - x1**4
            )
            # what this joint adds to J' and J'' of those before it, and the sums up to it, itself included
            sums[c, 0], sums[c, 1] = reach * state.first[row], reach * (state.second[row] + square)
            sums[c, 2], sums[c, 3] = y1, y2 + y1 * y1
            x1, x2, x3 = y1, y2, y3
        later1 = later2 = 0.0
        for c in range(count - 1, -1, -1):
            row, reach = tree.chains[i, c], reaches[c]
            first = reach * sums[c, 2] + later1
            other = reach * sums[c, 3] + later2
            bound = mass * (other * second + 2.0 * first * third + reach * fourth)
            buffers.bounds[joints.sources[row]] += abs(joints.multipliers[row]) * bound
            later1, later2 = later1 + sums[c, 0], later2 + sums[c, 1]


@kernel
def torques_at(tree: MassTree, zs: Rows, rates: Rows, rises: Rows, torques_out: RowsOut) -> None:
    """Write the torques (g, nv) of a group's coordinates at points, velocities and accelerations (g, nv)."""
    joints, nv = tree.joints, zs.shape[1]
    n, m, chain = joints.table.parents.shape[0], joints.sources.shape[0], tree.chains.shape[1]
    places, state = joint_places(joints), empty_bounds(nv, m)
    buffers = allocate_torque_buffers(n, nv, chain)
    for g in range(zs.shape[0]):
        state.z[:], state.dz[:], state.ddz[:] = zs[g], rates[g], rises[g]
        place_tree(tree, state, places)
        write_torques(tree, state, places, buffers, buffers.torques)
        torques_out[g] = buffers.torques


@uncounted
def _note(torques: Floats, time: float, found_out: Floats) -> None:
    for j in range(torques.shape[0]):
        if abs(torques[j]) > found_out[j, FOUND]:
            found_out[j, FOUND], found_out[j, TIME] = abs(torques[j]), time


@uncounted
def _write_most(begin: Floats, end: Floats, span: float, bounds: Floats, most_out: Floats) -> None:
    """Write what no torque exceeds in a time, by those at its ends and the bounds of their second derivatives."""
    for j in range(begin.shape[0]):
        most_out[j] = max(abs(begin[j]), abs(end[j])) + span * span / 8.0 * bounds[j]


@uncounted
def _is_close(most: Floats, loose: Floats, tight: Floats, limits: Floats, found: Floats) -> bool:
    """Tell if no bound exceeds the largest torque found by more than its tolerance."""
    is_close = True
    for j in range(most.shape[0]):
        largest = found[j, FOUND]
        tolerance = tight[j] if largest <= limits[j] < most[j] else loose[j]
        is_close &= most[j] <= largest + max(tolerance, EXCESS * largest)
    return is_close


@uncounted
def _note_bounds(most: Floats, found_out: Floats) -> None:
    """Note what no torque exceeds in a time among the bounds of the whole motion."""
    for j in range(most.shape[0]):
        found_out[j, BOUND] = max(found_out[j, BOUND], most[j])


@uncounted
def _place_and_write(
    tree: MassTree,
    motion: MotionPolynomials,
    piece: int,
    t: float,
    state: CoordinateBounds,
    places: JointPlaces,
    buffers: TorqueBuffers,
    torques_out: Floats,
) -> None:
    write_state(motion, piece, t, state)
    place_tree(tree, state, places)
    write_torques(tree, state, places, buffers, torques_out)


@uncounted
def _is_continued(motion: MotionPolynomials, piece: int, state: CoordinateBounds) -> bool:
    """Tell if a piece begins with the very rates with which the one before ends, but for rounding."""
    for j in range(state.dz.shape[0]):
        rate, rise = motion.powers[piece, 1, j], 2.0 * motion.powers[piece, 2, j]
        if abs(rate - state.dz[j]) > SAME * abs(rate) or abs(rise - state.ddz[j]) > SAME * abs(rise):
            return False
    return True


@kernel
def largest_torques(
    tree: MassTree, motion: MotionPolynomials, loose: Row, tight: Row, limits: Row, found_out: RowsOut
) -> float:
    """Write the largest torque of each coordinate along a motion, (nv, 3): see `carried_rates.FOUND`; return the work.

    Intervals are halved, `HALVINGS` times at most, until each bound is no more than a tolerance above what is found, or
    a share `EXCESS` of that. Tolerances (nv,) are tight where a limit is between the two; infinite ones may be.
    The work is that of all joints, taken or given back alike, by Simpson's rule on each piece [J].
    """
    joints, times, nv = tree.joints, motion.times, motion.powers.shape[2]
    n, m, chain = joints.table.parents.shape[0], joints.sources.shape[0], tree.chains.shape[1]
    places, state, radii = joint_places(joints), empty_bounds(nv, m), np.empty((n, chain))
    now, then, reached = np.empty(nv), np.empty(nv), np.empty(nv)
    buffers, pieces, work, halved = allocate_torque_buffers(n, nv, chain), times.shape[0] - 1, 0.0, 0
    bends, most = np.empty((pieces, nv)), np.empty((2 * pieces, nv))  # of second derivatives; of torques, by halves
    found_out[:, :] = 0.0
    for piece in range(pieces):
        length = times[piece + 1] - times[piece]
        for half in range(3):
            t = 0.5 * half * length
            if half > 0 or piece == 0 or not _is_continued(motion, piece, state):
                _place_and_write(tree, motion, piece, t, state, places, buffers, then)
                _note(then, times[piece] + t, found_out)
            for j in range(nv):
                work += length / 6.0 * (4.0 if half == 1 else 1.0) * abs(then[j] * state.dz[j])
            if half == 1:
                write_radii(tree, places, radii)
                bound_rates(joints, motion, piece, 0.0, length, state)
                _write_bounds(tree, 0.5 * length, state, radii, buffers)
                bends[piece] = buffers.bounds
            if half > 0:
                _write_most(now, then, 0.5 * length, bends[piece], most[2 * piece + half - 1])
            now[:] = then
    for j in range(nv):
        found_out[j, BOUND] = found_out[j, FOUND]
    for half in range(2 * pieces):
        if halved >= HALVINGS or _is_close(most[half], loose, tight, limits, found_out):
            _note_bounds(most[half], found_out)
            continue
        piece = half // 2
        length = times[piece + 1] - times[piece]
        since, end, step = 0.5 * (half % 2) * length, 0.5 * (half % 2 + 1) * length, 0.25 * length
        halved += 1
        _place_and_write(tree, motion, piece, since, state, places, buffers, now)
        while since < end:
            step = min(step, end - since)
            until = end if since + step >= end else since + step
            _place_and_write(tree, motion, piece, until, state, places, buffers, then)
            _note(then, times[piece] + until, found_out)
            buffers.bounds[:] = bends[piece]
            if step < CLOSER * length:  # there are better ones
                write_radii(tree, places, radii)
                bound_rates(joints, motion, piece, since, until, state)
                _write_bounds(tree, step, state, radii, buffers)
            _write_most(now, then, step, buffers.bounds, reached)
            if (
                step > SHORTEST * length
                and halved < HALVINGS
                and not _is_close(reached, loose, tight, limits, found_out)
            ):
                step *= 0.5
                halved += 1
                continue
            _note_bounds(reached, found_out)
            since = until
            now[:] = then
            step *= 2.0
    return work
