"""How much closer bodies can come along parts of a motion: rigorous bounds, from one configuration of each part.

A part is in a box about its middle m, and near a straight way through it: q = m + t c + o with |t| <= 1 and |o| <= off.
Of both bounds of how far a point of a body gets from where it is at m the smaller one counts:

    in the box      sum_j 2 sin(e_j / 2) rho_j    (`collision.motion_bound` has the proof)
    near the way    |x'| + |x''| / 2 + sum_j 2 sin(off_j / 2) rho'_j

The second: from m to m + t c it gets as far as it does in a time of 1 that begins with the speed at m and the rates
v = |c|, and from there as far as in a box. With rho'_j = rho_j + sum_i 2 sin(v_i / 2) rho_i for a joint that turns,
which is how far from axis j it is anywhere on the way, `collision.closing` proves

    |x''|  <=  sum_j rho'_j v_j (2 sum_{i before j} v_i + v_j),   i and the last v_j only where they turn.

A pair loses what its bodies move as seen from the last joint that moves both: sums run over the joints from
`apart_from` on. All those sums are differences of sums over the joints from some column to the last.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import void

from guidefield.kernels.certificate.tables import ROBOT, CertifiedRobot
from guidefield.kernels.jit.no_refcount import lane_uncounted
from guidefield.kernels.jit.signatures import BLOCKS, BLOCKS_OUT, MATRIX, MATRIX_OUT, Floats, lane_kernel


class _Room(NamedTuple):
    """What a part's bounds are computed in; n columns.

    Attributes:
        widths, rates, off: Half widths of the box, |c| and the most off the way, of the joints' moves, shape (n,).
        box, way, beside: How far each joint moves what is 1 m from its axis within those, shape (n,).
        turned: How far all turning joints before one turn at the rates, shape (n,).
        square: Squared distance of a body's centre from each column's axis, shape (n,) [m^2].
        reach: Largest distance of a body from each axis, shape (n,) [m].
        travel: How far bodies get that joints from one on move, shape (r, n + 1) [m].
    """

    widths: Floats
    rates: Floats
    off: Floats
    box: Floats
    way: Floats
    beside: Floats
    turned: Floats
    square: Floats
    reach: Floats
    travel: Floats


@lane_uncounted
def _spread(robot: CertifiedRobot, widths: Floats, s: int, spread: Floats, sweep: Floats) -> None:
    """Half widths (n,) of the joints' moves of those in the chart, row s, and how far they move what is 1 m away."""
    n = spread.shape[0]
    for j in range(n):
        sweep[j] = 0.0
        for i in range(widths.shape[1]):
            sweep[j] += robot.half_widths[j, i] * abs(widths[s, i])
    for j in range(n):
        square = sweep[j] * sweep[j]
        if not robot.alone[0, j]:
            square = 0.0
            for i in range(n):
                square += sweep[i] * sweep[i] * robot.together[i, j]
        spread[j] = math.sqrt(square)
    for j in range(n):
        sweep[j] = 2.0 * math.sin(0.5 * min(spread[j], math.pi)) if robot.turns[0, j] else spread[j]


@lane_uncounted
def _find_reach(robot: CertifiedRobot, b: int, jacobian: Floats, centre: Floats, room: _Room) -> None:
    """Largest distance of a body from each axis that moves it: 1 where it slides, 0 for what doesn't move it."""
    n = room.reach.shape[0]
    x, y, z = centre[0], centre[1], centre[2]
    for j in range(n):
        wx, wy, wz = jacobian[3, j], jacobian[4, j], jacobian[5, j]
        vx = jacobian[0, j] + wy * z - wz * y
        vy = jacobian[1, j] + wz * x - wx * z
        vz = jacobian[2, j] + wx * y - wy * x
        room.square[j] = vx * vx + vy * vy + vz * vz
    for j in range(n):
        room.reach[j] = 0.0
        if robot.moved_by[b, j]:
            square = room.square[j]
            if not robot.alone[0, j]:
                square = 0.0
                for i in range(n):
                    square += room.square[i] * robot.centred[i, j]
            room.reach[j] = math.sqrt(square) + (robot.radii[b] if robot.turns[0, j] else 0.0)


@lane_uncounted
def _find_travel(robot: CertifiedRobot, b: int, jacobian: Floats, moves: Floats, centre: Floats, room: _Room) -> None:
    """How far points of a body get that the joints from each column on move, row b of the room's travel.

    Args:
        robot: The robot.
        b: The body.
        jacobian: Joint Jacobian at the middle, shape (6, n).
        moves: Velocities of the joints there where c is that in the chart, shape (n,).
        centre: Centre of the ball about the body, shape (3,) [m, world].
        room: With the widths, rates and sweeps, and the body's reach.
    """
    x, y, z = centre[0], centre[1], centre[2]
    box, swept, beside, turning_beside = 0.0, 0.0, 0.0, 0.0
    vx, vy, vz, wx, wy, wz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    # sums of g_j v_j and g_j v_j (2 turned_j + v_j), with g_j = rho_j and with g_j = 1 where joint j turns
    fast, changing, turning_fast, turning_changing = 0.0, 0.0, 0.0, 0.0
    n = room.reach.shape[0]
    room.travel[b, n] = 0.0
    for j in range(n - 1, -1, -1):
        if robot.moved_by[b, j]:
            rho, v = room.reach[j], room.rates[j]
            vx += moves[j] * jacobian[0, j]
            vy += moves[j] * jacobian[1, j]
            vz += moves[j] * jacobian[2, j]
            wx += moves[j] * jacobian[3, j]
            wy += moves[j] * jacobian[4, j]
            wz += moves[j] * jacobian[5, j]
            box += rho * room.box[j]
            swept += rho * room.way[j]
            beside += rho * room.beside[j]
            within = v * (2.0 * room.turned[j] + robot.doubled[j] * v)
            fast += rho * v
            changing += rho * within
            if robot.turns[0, j]:
                turning_beside += room.beside[j]
                turning_fast += v
                turning_changing += within
        # turned_i of the formula counts from column j on
        before = 2.0 * room.turned[j]
        bent = changing - before * fast + swept * (turning_changing - before * turning_fast)
        mx, my, mz = vx + wy * z - wz * y, vy + wz * x - wx * z, vz + wx * y - wy * x
        speed = math.sqrt(mx * mx + my * my + mz * mz) + math.sqrt(wx * wx + wy * wy + wz * wz) * robot.radii[b]
        near = speed + 0.5 * bent + beside + swept * turning_beside
        room.travel[b, j] = min(box, near)


@lane_uncounted
def _find_turned(robot: CertifiedRobot, b: int, room: _Room) -> None:
    """How far the joints before each that turn a body turn it at the rates."""
    turned = 0.0
    for j in range(room.turned.shape[0]):
        room.turned[j] = turned
        if robot.moved_by[b, j] and robot.turns[0, j]:
            turned += room.rates[j]


@lane_kernel(
    void(ROBOT, BLOCKS, BLOCKS, MATRIX, MATRIX, MATRIX, MATRIX, BLOCKS_OUT, MATRIX_OUT, MATRIX_OUT),
)
def find_losses(
    robot: CertifiedRobot,
    jacobians: Floats,
    placements: Floats,
    half_widths: Floats,
    chords: Floats,
    moves: Floats,
    off: Floats,
    centres: Floats,
    own: Floats,
    mixed: Floats,
) -> None:
    """Find how much closer bodies can come along s parts of a motion.

    Args:
        robot: The robot.
        jacobians: Joint Jacobians at the parts' middles in the world frame, shape (s, 6, n).
        placements: ``T_world_joint`` there of every joint, shape (s, joints, 12) [m].
        half_widths: Of the boxes that the parts are in, shape (s, nv) [rad or m].
        chords: c, half of the way that each is near, shape (s, nv) [rad or m].
        moves: Velocities of all joints at the middles where c is that in the chart, shape (s, n).
        off: The most that each coordinate is off the way, shape (s, nv) [rad or m].
        centres: Out: centres there of the balls about bodies, shape (s, r, 3) [m, world].
        own: Out: how much closer the robot's own pairs can come, shape (s, p) [m].
        mixed: Out: how much closer its bodies can come to what stands still, shape (s, r) [m].
    """
    count, n = robot.moved_by.shape
    room = _Room(
        np.empty(n),
        np.empty(n),
        np.empty(n),
        np.empty(n),
        np.empty(n),
        np.empty(n),
        np.empty(n),
        np.empty(n),
        np.empty(n),
        np.empty((count, n + 1)),
    )
    for s in range(jacobians.shape[0]):
        _spread(robot, half_widths, s, room.widths, room.box)
        _spread(robot, chords, s, room.rates, room.way)
        _spread(robot, off, s, room.off, room.beside)
        for b in range(count):
            place, c = placements[s, robot.carriers[b]], robot.centres[b]
            for i in range(3):
                here = place[4 * i] * c[0] + place[4 * i + 1] * c[1] + place[4 * i + 2] * c[2]
                centres[s, b, i] = here + place[4 * i + 3]
            _find_reach(robot, b, jacobians[s], centres[s, b], room)
            _find_turned(robot, b, room)
            _find_travel(robot, b, jacobians[s], moves[s], centres[s, b], room)
            mixed[s, b] = room.travel[b, 0]
        for k in range(robot.own.shape[0]):
            since = robot.apart_from[k]
            own[s, k] = room.travel[robot.own[k, 0], since] + room.travel[robot.own[k, 1], since]
