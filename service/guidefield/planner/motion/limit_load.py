"""By how much a motion exceeds its limits: the factor by which time has to be stretched to reach them exactly."""

from __future__ import annotations

import math

import numpy as np

from guidefield.kernels.timing import hermite
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.robot.model.spaces import ChartPoints, ChartRate, ChartRates

TOLERANCE = 1e-9
"""By this share a motion may exceed a limit, for rounding."""

MOST_ROUNDS = 16
"""How often rounding is looked at again."""


def limit_load(
    times: np.ndarray,
    positions: ChartPoints,
    velocities: ChartRates,
    velocity_limits: ChartRate,
    acceleration_limits: ChartRate,
    jerk_limits: ChartRate,
) -> float:
    """The factor by which time has to be stretched to exceed no limit, and to reach one.

    The extrema of a Hermite piece are known exactly; its jerk is constant.

    Args:
        times: Of the knots, shape (n,), n >= 2 [s].
        positions: Shape (n, nv) [rad or m].
        velocities: Shape (n, nv) [rad/s or m/s].
        velocity_limits: Shape (nv,), positive [rad/s or m/s].
        acceleration_limits: Shape (nv,), positive [rad/s² or m/s²].
        jerk_limits: Shape (nv,), positive, infinite where there is none [rad/s³ or m/s³].
    """
    shares = np.empty(3)
    hermite.largest_shares(times, positions, velocities, velocity_limits, acceleration_limits, jerk_limits, shares)
    velocity, acceleration, jerk = shares.tolist()
    return max(velocity, math.sqrt(acceleration), math.cbrt(jerk))


def at_limits(
    times: np.ndarray,
    positions: ChartPoints,
    velocities: ChartRates,
    velocity_limits: ChartRate,
    acceleration_limits: ChartRate,
    jerk_limits: ChartRate,
) -> Trajectory:
    """A motion with time scaled so that it reaches a limit and exceeds none.

    Args:
        times: Of the knots, shape (n,), n >= 2 [s].
        positions: Shape (n, nv) [rad or m].
        velocities: Shape (n, nv) [rad/s or m/s].
        velocity_limits: Shape (nv,), positive [rad/s or m/s].
        acceleration_limits: Shape (nv,), positive [rad/s² or m/s²].
        jerk_limits: Shape (nv,), positive, infinite where there is none [rad/s³ or m/s³].
    """
    stretch, margin = 1.0, 1e-12
    for _ in range(MOST_ROUNDS):
        load = limit_load(
            times * stretch, positions, velocities / stretch, velocity_limits, acceleration_limits, jerk_limits
        )
        if stretch != 1.0 and load <= 1.0:
            break
        # rounding can leave a trace of excess: judge again, with more margin each time
        stretch *= load * (1.0 + margin)
        margin *= 4.0
    # adding 0 turns the -0 of a joint that moves backwards from rest into 0
    return Trajectory(times * stretch, positions, velocities / stretch + 0.0, max(stretch, 1.0))
