"""The motion from rest to rest straight between two chart points: a cubic, or pieces of constant jerk.

Where no jerk is limited it is the cubic  3 s^2 - 2 s^3,  whose acceleration jumps at its ends. Where one is, the jerk
is constant and positive in the first quarter of the time, negative in the half after it, positive in the last quarter:
of motions whose acceleration begins and ends at 0 the one with the least jerk.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np

from guidefield.planner.motion.timing import Limits
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.read_only import ReadOnly
from guidefield.robot.model.spaces import ChartPoint, ChartPoints, ChartRates


@dataclass(frozen=True, eq=False)
class Profile(ReadOnly):
    """How a way d is gone in a time T.

    Attributes:
        shares: Of T, at its knots, shape (k,), from 0 to 1.
        ways: Of d, at its knots, shape (k,), from 0 to 1.
        speeds: At its knots, in d/T, shape (k,).
    """

    shares: np.ndarray
    ways: np.ndarray
    speeds: np.ndarray
    velocity: float
    acceleration: float
    jerk: float

    @property
    def pieces(self) -> int:
        """How many of a cubic it has."""
        return len(self.shares) - 1

    def through(self, points: ChartPoints, times: np.ndarray) -> Trajectory:
        """The motion through points (n, nv), at rest at each, where it is at times (n,) [s]."""
        spans, ways = np.diff(times)[:, None], np.diff(points, axis=0)[:, None]
        begins, inner = times[:-1, None], slice(0, -1)
        positions = points[:-1, None] + self.ways[inner, None] * ways
        velocities = self.speeds[inner, None] * (ways / spans[:, None])
        nv = points.shape[1]
        return Trajectory(
            np.append((begins + self.shares[inner] * spans).ravel(), times[-1]),
            cast(ChartPoints, np.concatenate([positions.reshape(-1, nv), points[-1:]])),
            cast(ChartRates, np.concatenate([velocities.reshape(-1, nv), np.zeros((1, nv))])),
        )

    def duration(self, start: ChartPoint, end: ChartPoint, limits: Limits, nominal: float) -> float:
        """How long the motion takes [s].

        Args:
            start: Chart point, shape (nv,) [rad or m].
            end: Chart point, shape (nv,).
            nominal: The share of the velocity's limit that it uses; its square of the acceleration's, its cube of the
                jerk's.
        """
        way = np.abs(end - start)
        lasts = [self.velocity * way / limits.velocity, np.sqrt(self.acceleration * way / limits.acceleration)]
        if np.isfinite(self.jerk):
            lasts.append(np.cbrt(self.jerk * way / limits.jerk))
        return max(float(np.max(lasts)) / nominal, SHORTEST)


SHORTEST = 1e-3
"""A motion lasts so long at least [s]."""

CUBIC = Profile(np.array([0.0, 1.0]), np.array([0.0, 1.0]), np.zeros(2), 1.5, 6.0, np.inf)
LEAST_JERK = Profile(
    np.array([0.0, 0.25, 0.75, 1.0]),
    np.array([0.0, 1.0 / 12.0, 11.0 / 12.0, 1.0]),
    np.array([0.0, 1.0, 1.0, 0.0]),
    2.0,
    8.0,
    32.0,
)


def profile_of(limits: Limits) -> Profile:
    """The one that is gone within limits."""
    return LEAST_JERK if np.isfinite(limits.jerk).any() else CUBIC
