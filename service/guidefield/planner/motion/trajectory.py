"""A motion in time: the cubic Hermite curve through knots of time, position and velocity.

This very curve is certified, sent in replies, and read by kernels (`tables`): its formula has to stay.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import cast

import numpy as np

from guidefield.kernels.timing.carried_rates import MotionPolynomials
from guidefield.kernels.timing.hermite import states_at
from guidefield.read_only import ReadOnly, read_only
from guidefield.robot.model.spaces import ChartCurves, ChartPoints, ChartRates


@dataclass(frozen=True, eq=False)
class MotionSamples(ReadOnly):
    """States of a motion at given times: for reporting and drawing.

    A curve laid through samples is another curve than the one they were taken from; certificates and limits speak about
    the `Trajectory`.
    """

    times: np.ndarray  # shape (k,) [s]
    positions: ChartPoints  # chart coordinates, shape (k, nv) [rad or m]
    velocities: ChartRates  # shape (k, nv) [rad/s or m/s]
    accelerations: ChartRates  # shape (k, nv) [rad/s² or m/s²]


@dataclass(frozen=True, eq=False)
class Trajectory(ReadOnly):
    """The executed motion, defined as the cubic Hermite curve in time through its knots.

    Between two knots the velocity is quadratic and the acceleration linear in time, so their extrema are known exactly.
    Position and velocity are continuous; the acceleration steps at knots. A motion that goes nowhere has a single knot.
    """

    times: np.ndarray  # times of the knots, shape (n,), strictly increasing from 0 [s]
    positions: ChartPoints  # chart coordinates at the knots, shape (n, nv) [rad or m]
    velocities: ChartRates  # shape (n, nv) [rad/s or m/s]
    # factor, at least 1, by which `stretch_to_limits` stretched the times to keep every limit everywhere
    stretch: float = 1.0
    # shape (n, nv): at each knot those of the piece that starts there, at the last knot those of the piece that ends
    # there [rad/s² or m/s²]
    accelerations: ChartRates = field(init=False)
    _ends: ChartRates = field(init=False, repr=False)

    def __post_init__(self) -> None:
        at_start, at_end = piece_accelerations(self.times, self.positions, self.velocities)
        last = at_end[-1:] if len(at_end) else np.zeros_like(self.velocities)
        object.__setattr__(self, "accelerations", np.concatenate([at_start, last]))
        object.__setattr__(self, "_ends", at_end)
        super().__post_init__()

    @property
    def duration(self) -> float:
        """Time from the first knot to the last [s]."""
        return float(self.times[-1] - self.times[0])

    @property
    def peak_jerk(self) -> float:
        """Largest |da/dt| of any joint inside a piece [rad/s³ or m/s³]; the steps at knots are not counted."""
        return float(np.abs(self._jerks).max(initial=0.0))

    @property
    def mean_accelerations(self) -> ChartRates:
        """At the knots the mean of the two pieces that meet there, at the ends that of the one piece, shape (n, nv)."""
        mean = self.accelerations.copy()
        mean[1:-1] = 0.5 * (self.accelerations[1:-1] + self._ends[:-1])
        return mean

    @cached_property
    def _jerks(self) -> np.ndarray:
        """Of the pieces, shape (n - 1, nv) [rad/s³ or m/s³]."""
        jerks: np.ndarray = (self._ends - self.accelerations[:-1]) / np.diff(self.times)[:, None]
        read_only(jerks)
        return jerks

    @cached_property
    def tables(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Knots and jerks as kernels take them, see `states_at`."""
        arrays = self.times, self.positions, self.velocities, self.accelerations, self._jerks
        times, positions, velocities, accelerations, jerks = (np.ascontiguousarray(array, float) for array in arrays)
        read_only(times, positions, velocities, accelerations, jerks)
        return times, positions, velocities, accelerations, jerks

    @cached_property
    def polynomials(self) -> MotionPolynomials:
        """The pieces by powers of time; none of a motion that goes nowhere."""
        times, positions, velocities, accelerations, jerks = self.tables
        last = len(jerks)
        rows = (positions[:last], velocities[:last], accelerations[:last] / 2.0, jerks / 6.0)
        powers = np.ascontiguousarray(np.stack(rows, axis=1))
        read_only(powers)
        return MotionPolynomials(times, powers)

    def bezier(self) -> ChartCurves:
        """Control points of the pieces, shape (max(n - 1, 1), 4, nv): this very curve [rad or m].

        Piece i runs from ``times[i]`` to ``times[i + 1]``. A motion that goes nowhere is one piece of four equal
        points, so that a judge of the pieces judges its only configuration.
        """
        return self._bezier

    @cached_property
    def _bezier(self) -> ChartCurves:
        if len(self.times) == 1:
            curves = np.repeat(self.positions[None], 4, axis=1)
        else:
            curves = bezier(self.times, self.positions, self.velocities)
        read_only(curves)
        return curves

    def piece_times(self) -> np.ndarray:
        """When the pieces of `bezier` begin, and the last one ends, shape (m + 1,) [s]."""
        return np.repeat(self.times, 2) if len(self.times) == 1 else self.times.copy()

    def evaluate(self, times: np.ndarray) -> tuple[ChartPoints, ChartRates, ChartRates]:
        """Position, velocity and acceleration (k, nv) at times (k,) [s].

        Before the start and after the end it is at rest.
        """
        times = np.ascontiguousarray(times, dtype=float)
        if len(self._jerks) == 0:
            still = cast(ChartRates, np.zeros((len(times), self.positions.shape[1])))
            return still + self.positions[0], still, still.copy()
        q, v, a = (np.empty((len(times), self.positions.shape[1])) for _ in range(3))
        states_at(*self.tables, times, q, v, a)
        return cast(ChartPoints, q), cast(ChartRates, v), cast(ChartRates, a)

    def resample(self, rate: float) -> MotionSamples:
        """States at a uniform rate [Hz], and at the very end.

        Raises:
            ValueError: if the rate is not finite and positive.
        """
        if not (math.isfinite(rate) and rate > 0.0):
            raise ValueError(f"a sample rate has to be finite and positive, got {rate}")
        ticks = np.arange(math.ceil(self.duration * rate)) / rate
        # a tick that rounding put at the end, or beyond it, gives way to the end
        times = np.append(ticks[ticks < self.duration * (1.0 - 1e-12)], self.duration) + self.times[0]
        return MotionSamples(times, *self.evaluate(times))


def concatenate(parts: Sequence[Trajectory]) -> Trajectory:
    """Motions one after the other, each of which begins where the last one ends, with its velocities."""
    moving = [part for part in parts if part.duration > 0.0] or [parts[0]]
    times, begin = [moving[0].times[:1]], 0.0
    for part in moving:
        times.append(begin + part.times[1:])
        begin += part.duration
    positions = [moving[0].positions, *(part.positions[1:] for part in moving[1:])]
    velocities = [moving[0].velocities, *(part.velocities[1:] for part in moving[1:])]
    return Trajectory(
        np.concatenate(times),
        cast(ChartPoints, np.concatenate(positions)),
        cast(ChartRates, np.concatenate(velocities)),
    )


def unwrap_towards(first: Trajectory, then: Trajectory) -> Trajectory:
    """Add whole turns to the first motion, to end where the other begins; coordinates that don't wrap get none."""
    turns = np.round((then.positions[0] - first.positions[-1]) / (2.0 * np.pi))
    return Trajectory(first.times, cast(ChartPoints, first.positions + 2.0 * np.pi * turns), first.velocities)


def piece_accelerations(
    times: np.ndarray, positions: ChartPoints, velocities: ChartRates
) -> tuple[ChartRates, ChartRates]:
    """Accelerations at the two ends of every Hermite piece between n knots, each (n - 1, nv) [rad/s^2 or m/s^2]."""
    dt = (times[1:] - times[:-1])[:, None]
    mean = (positions[1:] - positions[:-1]) / dt
    start, end = velocities[:-1], velocities[1:]
    return (6.0 * mean - 4.0 * start - 2.0 * end) / dt, (2.0 * start + 4.0 * end - 6.0 * mean) / dt


def bezier(knots: np.ndarray, values: ChartPoints, slopes: ChartRates) -> ChartCurves:
    """Control points (n - 1, 4, c) of the pieces of a cubic Hermite curve: knots (n,), values and slopes (n, c)."""
    third = (knots[1:] - knots[:-1])[:, None] / 3.0
    start, end = values[:-1], values[1:]
    curves = cast(ChartCurves, np.empty((len(start), 4, values.shape[1])))
    curves[:, 0], curves[:, 3] = start, end
    curves[:, 1], curves[:, 2] = start + slopes[:-1] * third, end - slopes[1:] * third
    return curves
