"""How fast a pair's bodies close in on each other between two places, and how fast that changes: rigorous bounds.

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
from guidefield.kernels.minimum.places import Places
from guidefield.kernels.minimum.tables import MovingRobot, RobotBodies

SPEED, ACCELERATION, BOUNDS = range(3)
"""Bounds of a mover: of its speed [m/s], of how fast that changes [m/s^2]; then how many there are."""


class Rates(NamedTuple):
    """The largest rates between two times.

    Attributes:
        row: Scratch, shape (MOST_ORDER,).
        z: Of the group's coordinates, shape (nv,).
        squares: Scratch, shape (n,).
        velocities, accelerations: Of the joints' moves, shape (n,).
        sweeps: How far each joint moves a point at a distance of 1 from the nearer end of the interval, shape (n,).
        rho: Scratch, shape (n,).
        known: Bounds of the speed and acceleration of each mover, shape (r + own, BOUNDS).
        asked: For which interval they are known, shape (r + own,).
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
def _of_body(
    robot: RobotBodies, b: int, by: Integers, low: int, high: int, places: Places, rates: Rates
) -> tuple[float, float]:
    """Bounds of the speed and the acceleration of a body's points by some coordinates, those before -1 (n,), in order.

    The first moves all others.
    """
    swept, count = 0.0, 0
    while count < by.shape[0] and by[count] >= 0:
        i = by[count]
        rates.rho[i] = max(places.reach[low, b, i], places.reach[high, b, i])
        swept += rates.rho[i] * rates.sweeps[i]
        count += 1
    before, fastest, changing = 0.0, 0.0, 0.0
    for k in range(count):
        i = by[k]
        turning = robot.turns[i]
        # whatever is between is no farther from one of the two in time than half of it
        rho, v = rates.rho[i] + swept * turning, rates.velocities[i]
        fastest += rho * v
        changing += rho * (rates.accelerations[i] + v * (2.0 * before + robot.doubled[i] * v))
        before += v * turning
    return fastest, changing


@uncounted
def closing_of(moving: MovingRobot, pair: int, interval: int, low: int, high: int, places: Places, rates: Rates) -> int:
    """Find the bounds of a pair's mover between two places; whose row of `rates.known` it is.

    Args:
        moving: The robot and the pairs.
        pair: Which of them.
        interval: Number of the interval between the two, another one for each.
        low: Row of the first place.
        high: Row of the second.
        places: The places.
        rates: The largest rates between them.
    """
    robot, pairs = moving.robot, moving.pairs
    own = pairs.first_by.shape[0]
    mover = robot.carriers.shape[0] + pair if pair < own else int(pairs.first[pair])
    if rates.asked[mover] == interval:
        return mover
    a, b = pairs.first[pair], pairs.second[pair]
    if pair < own:
        fastest, changing = _of_body(robot, a, pairs.first_by[pair], low, high, places, rates)
        more, also = _of_body(robot, b, pairs.second_by[pair], low, high, places, rates)
        fastest, changing = fastest + more, changing + also
    else:
        fastest, changing = _of_body(robot, a, robot.moved_by[a], low, high, places, rates)
    span = places.times[high] - places.times[low]
    mean = 0.5 * (places.speeds[low, mover] + places.speeds[high, mover])
    rates.known[mover, SPEED] = min(fastest, mean + 0.5 * changing * span)
    rates.known[mover, ACCELERATION] = changing
    rates.asked[mover] = interval
    return mover
