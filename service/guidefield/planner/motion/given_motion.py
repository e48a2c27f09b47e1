"""A motion that somebody else made, as the curve that is judged: Hermite knots, samples or waypoints.

Knots with velocities are the cubic Hermite curve through them. Through samples in time goes the cubic spline whose
accelerations are continuous: a robot can't follow a step of velocity, and where the samples are of a smooth motion the
spline is off by the fourth power of their distance only. Waypoints are joined by straight pieces.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from functools import cached_property
from typing import cast

import numpy as np

from guidefield.kernels.timing import hermite as not_a_knot
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.motion.waypoints import polyline
from guidefield.read_only import ReadOnly
from guidefield.robot.model.spaces import ChartCurves, ChartPoint, ChartPoints, ChartRates

SHORTEST = 1e-3  # time that a straight piece takes at least where only the order of places counts


class CurveKind(enum.Enum):
    """Which curve is judged; the values are the words of replies."""

    HERMITE = "hermite"
    SPLINE = "spline"
    LINEAR = "linear"


@dataclass(frozen=True, eq=False)
class StraightMotion(ReadOnly):
    """Straight pieces, each run through evenly: the velocity jumps at knots."""

    times: np.ndarray  # shape (n,), n >= 2, strictly increasing [s]
    positions: ChartPoints  # chart points, shape (n, nv) [rad or m]

    @property
    def duration(self) -> float:
        """[s]."""
        return float(self.times[-1] - self.times[0])

    def bezier(self) -> ChartCurves:
        """Control points of the pieces, shape (n - 1, 2, nv) [rad or m]."""
        return polyline(self.positions)

    def piece_times(self) -> np.ndarray:
        """When they begin, and the last one ends, shape (n,) [s]."""
        return self.times.copy()

    def evaluate(self, times: np.ndarray) -> tuple[ChartPoints, ChartRates]:
        """Chart points and rates at times (k,) [s], both of shape (k, nv) [rad or m, and per s]."""
        piece = np.searchsorted(self.times[1:-1], times, side="right")
        rates = np.diff(self.positions, axis=0) / np.diff(self.times)[:, None]
        return self.positions[piece] + (times - self.times[piece])[:, None] * rates[piece], rates[piece]


@dataclass(frozen=True, eq=False)
class GivenMotion(ReadOnly):
    """A curve through the rows of a motion."""

    kind: CurveKind
    positions: ChartPoints  # chart points at the knots, shape (n, nv), no two consecutive ones at one time [rad or m]
    rows: np.ndarray  # which of the given rows each knot is, shape (n,); the last is the last one
    times: np.ndarray | None = None  # of the knots, shape (n,), strictly increasing [s]; None where there are none
    velocities: ChartRates | None = None  # at the knots, shape (n, nv) [rad/s or m/s]; None of straight pieces
    # of a single knot, which has no curve to tell them, as they are given, shape (k, nv) [rad/s² or m/s²]; else None
    accelerations: ChartRates | None = None

    @property
    def is_point(self) -> bool:
        """True if there is a single knot."""
        return len(self.positions) == 1

    @cached_property
    def pieces(self) -> ChartCurves:
        """Bezier control points, shape (m, k, nv), m = max(n - 1, 1): what is judged [rad or m]."""
        if self.velocities is None or self.times is None:
            return polyline(self.positions)
        return cast(Trajectory, self.measured).bezier()

    @cached_property
    def measured(self) -> Trajectory | StraightMotion:
        """The same places in the same order, for the smallest distances to obstacles that rest.

        Straight pieces begin and end at rest here, which makes the rates continuous and leaves the places as they are;
        those without times take as long as they are.
        """
        if self.velocities is not None and self.times is not None:
            return Trajectory(self.times, self.positions, self.velocities)
        times = self.times
        if times is None:
            lengths = np.linalg.norm(np.diff(self.positions, axis=0), axis=1)
            times = np.concatenate([[0.0], np.cumsum(np.maximum(lengths, SHORTEST))])
        return Trajectory(times, self.positions, cast(ChartRates, np.zeros(self.positions.shape)))

    @cached_property
    def scheduled(self) -> Trajectory | StraightMotion:
        """The motion as it is in time: among obstacles that move.

        Raises:
            ValueError: if it has no times.
        """
        if self.times is None:
            raise ValueError("a path has no times")
        if self.velocities is not None or self.is_point:
            return self.measured
        return StraightMotion(self.times, self.positions)

    def along(self, piece: int, share: float) -> tuple[float, float | None]:
        """The row and the time [s] of a place.

        Args:
            piece: Index in `pieces`.
        """
        if self.is_point:
            return float(self.rows[-1]), None if self.times is None else float(self.times[0])
        first, last = self.rows[piece], self.rows[piece + 1]
        row = float(first + share * (last - first))
        if self.times is None:
            return row, None
        return row, float(self.times[piece] + share * (self.times[piece + 1] - self.times[piece]))

    def along_measured(self, time: float) -> tuple[float, float | None]:
        """The row and the time [s] of a place that was found at a time of `measured` [s]."""
        times = self.measured.times
        piece = int(np.clip(np.searchsorted(times, time, side="right") - 1, 0, max(len(times) - 2, 0)))
        if self.is_point:
            return self.along(0, 0.0)
        share = float(np.clip((time - times[piece]) / (times[piece + 1] - times[piece]), 0.0, 1.0))
        return self.along(piece, share if self.velocities is not None else share**2 * (3.0 - 2.0 * share))

    @property
    def end(self) -> tuple[float, float | None]:
        """The row and the time of its end [s]."""
        return self.along(len(self.pieces) - 1, 1.0)

    @property
    def start(self) -> ChartPoint:
        """The first chart point, shape (nv,)."""
        point: ChartPoint = self.positions[0]
        return point


def spline_rates(times: np.ndarray, positions: ChartPoints) -> ChartRates:
    """Rates at samples (n, nv) of the cubic through them with continuous accelerations, not-a-knot at its ends.

    It is a line through two samples, a parabola through three.
    """
    rates = cast(ChartRates, np.zeros(positions.shape))
    if len(times) == 1:
        return rates
    steps = np.diff(times)
    chords = np.diff(positions, axis=0) / steps[:, None]
    if len(times) == 2:
        rates[:] = chords[0]
    elif len(times) == 3:
        bend = (chords[1] - chords[0]) / (times[2] - times[0])
        rates[:] = chords[0] + np.array([-steps[0], steps[0], steps[0] + 2.0 * steps[1]])[:, None] * bend
    else:
        work = np.empty((2, len(times)))
        not_a_knot.slopes(steps, np.ascontiguousarray(positions), work[0], work[1], rates)
    return rates
