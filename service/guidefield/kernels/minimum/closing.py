"""How far a pair's bodies move relative to each other about a place, and how fast that changes: rigorous bounds.

The formulas and their reasons are those of `collision.closing`; its movers are the bodies, as the world sees them, and
the two bodies of own pairs, both as some body between them sees them: how far apart points are is the same from
anywhere. A short body that a joint turns beside a long one moves less than that, seen from the long one.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from guidefield.kernels.jit.no_refcount import uncounted
from guidefield.kernels.jit.signatures import Floats, Integers
from guidefield.kernels.minimum.curve_rates import largest_between
from guidefield.kernels.minimum.kept_distance import FIRST_TURNS, FIRST_TWIST, SECOND_TURNS, SECOND_TWIST, TWISTS
from guidefield.kernels.minimum.places import TWIST, Place
from guidefield.kernels.minimum.tables import MovingRobot, RobotBodies

SPEED, ACCELERATION, TRAVEL, BOUNDS = TWISTS, TWISTS + 1, TWISTS + 2, TWISTS + 3
"""Numbers of a mover, behind the twists of its bodies at the place: bounds of its speed [m/s], of how fast that changes
[m/s^2], and of how far it moves from where it is there [m]; then how many there are."""


class Rates(NamedTuple):
    """The largest rates between two times.

    Attributes:
        row: Scratch, shape (MOST_ORDER,).
        z: Of the group's coordinates, shape (nv,).
        squares: Scratch, shape (n,).
        velocities, accelerations: Of the joints' moves, shape (n,).
        sweeps: How far each joint moves a point at a distance of 1 from the middle of the interval on, shape (n,).
        rho: Scratch, shape (n,).
        known: What is known of each mover, shape (r + own, BOUNDS).
        asked: For which interval it is known, shape (r + own,).
    """

    row: Floats
    z: Floats
    squares: Floats
    velocities: Floats
    accelerations: Floats
    sweeps: Floats
    rho: Floats
    known: Floats
    asked: Floats


@uncounted
def _spread(robot: RobotBodies, rates: Rates, out: Floats) -> None:
    """Rates of the joints' moves of those of the group's coordinates, which are in `rates.z`."""
    n = robot.offset.shape[0]
    for i in range(n):
        total = 0.0
        for j in range(rates.z.shape[0]):
            total += robot.half_widths[i, j] * rates.z[j]
        rates.squares[i] = total * total
    for i in range(n):
        total = 0.0
        for k in range(n):
            total += robot.together[k, i] * rates.squares[k]
        out[i] = math.sqrt(total)


@uncounted
def find_rates(moving: MovingRobot, since: float, until: float, rates: Rates) -> None:
    """Find the largest rates between two times [s]."""
    robot, curve, half = moving.robot, moving.curve, 0.5 * (until - since)
    largest_between(curve.velocities, curve, since, until, rates.row, rates.z)
    _spread(robot, rates, rates.velocities)
    for j in range(rates.z.shape[0]):
        rates.z[j] *= half
    _spread(robot, rates, rates.sweeps)
    for i in range(robot.offset.shape[0]):
        if robot.turns[i] != 0.0:
            rates.sweeps[i] = 2.0 * math.sin(0.5 * min(rates.sweeps[i], math.pi))
    largest_between(curve.accelerations, curve, since, until, rates.row, rates.z)
    _spread(robot, rates, rates.accelerations)


@uncounted
def _reach(robot: RobotBodies, b: int, by: Integers, count: int, place: Place, rates: Rates) -> float:
    """Write how far a body is from the axes of some coordinates at the place; how far they sweep it, together [m].

    See `MotionBound.reach`. Coordinates of one joint stand together.
    """
    x, y, z = place.centres[b, 0], place.centres[b, 1], place.centres[b, 2]
    for k in range(count):
        S = place.subspaces[by[k]]
        vx, vy, vz = S[0] + S[4] * z - S[5] * y, S[1] + S[5] * x - S[3] * z, S[2] + S[3] * y - S[4] * x
        rates.squares[by[k]] = vx * vx + vy * vy + vz * vz
    swept = 0.0
    for k in range(count):
        i, square = by[k], 0.0
        for other in range(count):
            square += robot.centred[by[other], i] * rates.squares[by[other]]
        rates.rho[i] = math.sqrt(square) + robot.turns[i] * robot.radii[b]
        swept += rates.rho[i] * rates.sweeps[i]
    return swept


@uncounted
def _moves(movers: Integers, i: int) -> bool:
    """Whether a coordinate is among those that move a body, which stand before -1."""
    moves = False
    for k in range(movers.shape[0]):
        moves = moves or movers[k] == i
    return moves


@uncounted
def _of_body(
    robot: RobotBodies, b: int, by: Integers, place: Place, rates: Rates, known: Floats, twist: int, turns: int
) -> None:
    """Add the bounds of a body that some coordinates, those before -1 (n,), in order, move; write its twist.

    The first moves all others. A coordinate that doesn't move the body in the world is passed against its direction:
    whoever sees the body is moved by it instead.
    """
    count = 0
    while count < by.shape[0] and by[count] >= 0:
        count += 1
    swept = _reach(robot, b, by, count, place, rates)
    before, fastest, changing = 0.0, 0.0, 0.0
    for k in range(TWIST):
        known[twist + k] = 0.0
    for k in range(count):
        i = by[k]
        turning = robot.turns[i]
        # whatever is between is no farther from the middle in time than half of it
        rho, v = rates.rho[i] + swept * turning, rates.velocities[i]
        fastest += rho * v
        changing += rho * (rates.accelerations[i] + v * (2.0 * before + robot.doubled[i] * v))
        before += v * turning
        way = 1.0 if _moves(robot.moved_by[b], i) else -1.0
        for j in range(TWIST):
            known[twist + j] += way * place.twists[i, j]
    known[SPEED] += fastest
    known[ACCELERATION] += changing
    x, y, z = place.centres[b, 0], place.centres[b, 1], place.centres[b, 2]
    wx, wy, wz = known[twist + 3], known[twist + 4], known[twist + 5]
    vx, vy, vz = known[twist] + wy * z - wz * y, known[twist + 1] + wz * x - wx * z, known[twist + 2] + wx * y - wy * x
    known[turns] = math.sqrt(wx * wx + wy * wy + wz * wz)
    known[TRAVEL] += math.sqrt(vx * vx + vy * vy + vz * vz) + known[turns] * robot.radii[b]


@uncounted
def closing_of(moving: MovingRobot, pair: int, interval: int, half: float, place: Place, rates: Rates) -> int:
    """Find the bounds of a pair's mover about a place; whose row of `rates.known` it is.

    Args:
        moving: The robot and the pairs.
        pair: Which of them.
        interval: Number of the interval, another one for each.
        half: How long it is before and after the place [s].
        place: The robot in its middle.
        rates: The largest rates in it.
    """
    robot, pairs = moving.robot, moving.pairs
    own = pairs.first_by.shape[0]
    mover = robot.carriers.shape[0] + pair if pair < own else int(pairs.first[pair])
    if rates.asked[mover] == interval:
        return mover
    known, a, b = rates.known[mover], pairs.first[pair], pairs.second[pair]
    for k in range(BOUNDS):
        known[k] = 0.0
    if pair < own:
        _of_body(robot, a, pairs.first_by[pair], place, rates, known, FIRST_TWIST, FIRST_TURNS)
        _of_body(robot, b, pairs.second_by[pair], place, rates, known, SECOND_TWIST, SECOND_TURNS)
    else:
        _of_body(robot, a, robot.moved_by[a], place, rates, known, FIRST_TWIST, FIRST_TURNS)
    changed = known[ACCELERATION] * half
    known[TRAVEL] = half * min(known[SPEED], known[TRAVEL] + 0.5 * changed)
    rates.asked[mover] = interval
    return mover
