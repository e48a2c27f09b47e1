"""A motion in time, the cubic Hermite curve through knots; and the motion by constant jerks from any velocity to rest.

This very curve is certified, sent in replies, and read by kernels (`tables`): its formula has to stay. The constants
are of stops; `ROUNDING` also of optimised motions whose time isn't scaled. `RAMP` changes how long a stop takes. With
less of `ROUNDING` or `CLOSE`, with fewer `TRIES` or `SLOWER` nearer 1, more stops exceed a limit of jerk by rounding
(of 3,000 of seven joints 4 do, by less than a thousandth); more of them lower jerks further.
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
from guidefield.robot.model.joints import LocalCurves, LocalPoint, LocalPoints, LocalRate, LocalRates


@dataclass(frozen=True, eq=False)
class MotionSamples(ReadOnly):
    """States of a motion at given times: for reporting and drawing.

    A curve laid through samples is another curve than the one they were taken from; certificates and limits speak about
    the `Trajectory`.
    """

    times: np.ndarray  # shape (k,) [s]
    positions: LocalPoints  # local coordinates, shape (k, nv) [rad or m]
    velocities: LocalRates  # shape (k, nv) [rad/s or m/s]
    accelerations: LocalRates  # shape (k, nv) [rad/s² or m/s²]


@dataclass(frozen=True, eq=False)
class Trajectory(ReadOnly):
    """The executed motion, defined as the cubic Hermite curve in time through its knots.

    Between two knots the velocity is quadratic and the acceleration linear in time, so their extrema are known exactly.
    Position and velocity are continuous; the acceleration steps at knots. A motion that goes nowhere has a single knot.
    """

    times: np.ndarray  # times of the knots, shape (n,), strictly increasing from 0 [s]
    positions: LocalPoints  # local coordinates at the knots, shape (n, nv) [rad or m]
    velocities: LocalRates  # shape (n, nv) [rad/s or m/s]
    # factor, at least 1, by which `stretch_to_limits` stretched the times to keep every limit everywhere
    stretch: float = 1.0
    # shape (n, nv): at each knot those of the piece that starts there, at the last knot those of the piece that ends
    # there [rad/s² or m/s²]
    accelerations: LocalRates = field(init=False)
    _ends: LocalRates = field(init=False, repr=False)

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
    def mean_accelerations(self) -> LocalRates:
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

    def bezier(self) -> LocalCurves:
        """Control points of the pieces, shape (max(n - 1, 1), 4, nv): this very curve [rad or m].

        Piece i runs from ``times[i]`` to ``times[i + 1]``. A motion that goes nowhere is one piece of four equal
        points, so that a judge of the pieces judges its only configuration.
        """
        return self._bezier

    @cached_property
    def _bezier(self) -> LocalCurves:
        if len(self.times) == 1:
            curves = np.repeat(self.positions[None], 4, axis=1)
        else:
            curves = bezier(self.times, self.positions, self.velocities)
        read_only(curves)
        return curves

    def piece_times(self) -> np.ndarray:
        """Times at which the pieces of `bezier` begin, and the last one ends, shape (m + 1,) [s]."""
        return np.repeat(self.times, 2) if len(self.times) == 1 else self.times.copy()

    def evaluate(self, times: np.ndarray) -> tuple[LocalPoints, LocalRates, LocalRates]:
        """Position, velocity and acceleration (k, nv) at times (k,) [s].

        Before the start and after the end it is at rest.
        """
        times = np.ascontiguousarray(times, dtype=float)
        if len(self._jerks) == 0:
            still = cast(LocalRates, np.zeros((len(times), self.positions.shape[1])))
            return still + self.positions[0], still, still.copy()
        q, v, a = (np.empty((len(times), self.positions.shape[1])) for _ in range(3))
        states_at(*self.tables, times, q, v, a)
        return cast(LocalPoints, q), cast(LocalRates, v), cast(LocalRates, a)

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
        cast(LocalPoints, np.concatenate(positions)),
        cast(LocalRates, np.concatenate(velocities)),
    )


def unwrap_towards(first: Trajectory, then: Trajectory) -> Trajectory:
    """Add whole turns to the first motion, to end where the other begins; coordinates that don't wrap get none."""
    turns = np.round((then.positions[0] - first.positions[-1]) / (2.0 * np.pi))
    return Trajectory(first.times, cast(LocalPoints, first.positions + 2.0 * np.pi * turns), first.velocities)


def piece_accelerations(
    times: np.ndarray, positions: LocalPoints, velocities: LocalRates
) -> tuple[LocalRates, LocalRates]:
    """Accelerations at the two ends of every Hermite piece between n knots, each (n - 1, nv) [rad/s^2 or m/s^2]."""
    dt = (times[1:] - times[:-1])[:, None]
    mean = (positions[1:] - positions[:-1]) / dt
    start, end = velocities[:-1], velocities[1:]
    return (6.0 * mean - 4.0 * start - 2.0 * end) / dt, (2.0 * start + 4.0 * end - 6.0 * mean) / dt


def bezier(knots: np.ndarray, values: LocalPoints, slopes: LocalRates) -> LocalCurves:
    """Control points (n - 1, 4, c) of the pieces of a cubic Hermite curve: knots (n,), values and slopes (n, c)."""
    third = (knots[1:] - knots[:-1])[:, None] / 3.0
    start, end = values[:-1], values[1:]
    curves = cast(LocalCurves, np.empty((len(start), 4, values.shape[1])))
    curves[:, 0], curves[:, 3] = start, end
    curves[:, 1], curves[:, 2] = start + slopes[:-1] * third, end - slopes[1:] * third
    return curves


RAMP = 0.02  # where there is no limit of jerk, accelerations rise to their limit in this time [s]
APART = 1e-9  # times that are closer than this are one [s]: with more, stops aren't exact
ROUNDING = 1e-5  # share of a jerk limit that is left for the rounding of jerks in short pieces
CLOSE = 5e-4  # in pieces shorter than this, rounding of jerks is more than that, at `CLOSE_JERK` [s]
CLOSE_JERK = 100.0  # [rad/s³ or m/s³]
SLOWER = 0.998  # a joint's jerk is lowered by this factor at a time
TRIES = 60  # times that it is lowered at most


def choose_jerks(acceleration_limits: LocalRate, jerk_limits: LocalRate | None, rises: LocalRate) -> LocalRate:
    """The jerks with which joints stop, shape (nv,), all finite [rad/s³ or m/s³].

    `rises` (nv,) are the least jerks that keep the velocities' limits.
    """
    own = np.maximum(acceleration_limits / RAMP, 1.01 * rises)
    if jerk_limits is None:
        return own
    kept = np.minimum(jerk_limits, np.maximum(rises, (1.0 - ROUNDING) * jerk_limits))
    return np.where(np.isfinite(jerk_limits), kept, own)


def separate_jerks(
    velocity: LocalRate, acceleration: LocalRate, acceleration_limits: LocalRate, jerks: LocalRate, rises: LocalRate
) -> LocalRate:
    """Jerks (nv,), some of them a little lower, with which no two knots of `stop_motion` are close but not the same.

    In pieces that short the jerk of a curve is rounding. Where no such jerk is found, the one with the least rounding
    is chosen; none is less than it rises at least.
    """
    chosen, knots = jerks.copy(), np.zeros(1)
    close = CLOSE * float(np.cbrt(min(CLOSE_JERK / jerks.min(), 1.0)))  # rounding goes with the inverse cube of times
    for j, (v, a, limit, least) in enumerate(zip(velocity, acceleration, acceleration_limits, rises, strict=True)):
        jerk, least_rounding = float(jerks[j]), math.inf
        for _ in range(TRIES):
            both = _add_jerk_times(knots, float(v), float(a), float(limit), jerk)
            gaps = np.diff(both)
            apart, rounding = bool((gaps >= close).all()), float((gaps**-3).sum())
            if apart or rounding < least_rounding:
                least_rounding, chosen[j] = rounding, jerk
            jerk *= SLOWER
            if apart or jerk < least:
                break
        knots = _add_jerk_times(knots, float(v), float(a), float(limit), float(chosen[j]))
    return chosen


def _add_jerk_times(knots: np.ndarray, velocity: float, acceleration: float, limit: float, jerk: float) -> np.ndarray:
    """Times (n,) with those at which a joint's jerk changes, in order, each once."""
    spans = [span for span, _ in _phases(velocity, acceleration, limit, jerk)]
    times = np.unique(np.concatenate([knots, np.cumsum(spans)]))
    apart: np.ndarray = times[np.concatenate([[True], np.diff(times) > APART])]
    return apart


def stop_motion(
    position: LocalPoint, velocity: LocalRate, acceleration: LocalRate, acceleration_limits: LocalRate, jerks: LocalRate
) -> Trajectory:
    """The motion to rest, without acceleration, each joint by itself, with positive and finite jerks (nv,).

    Its knots are where any joint's jerk changes, so that it is exact; a single knot if it is at rest.
    """
    phases = [_phases(*map(float, one)) for one in zip(velocity, acceleration, acceleration_limits, jerks, strict=True)]
    bounds = np.array([np.cumsum([span for span, _ in one]) for one in phases])
    times = np.unique(np.concatenate([[0.0], bounds.ravel()]))
    times = times[np.concatenate([[True], np.diff(times) > APART])]
    begins = zip(position, velocity, acceleration, phases, strict=True)
    states = [_states(times, float(x), float(v), float(a), spans) for x, v, a, spans in begins]
    positions = cast(LocalPoints, np.column_stack([x for x, _ in states]))
    velocities = cast(LocalRates, np.column_stack([v for _, v in states]))
    positions[0], velocities[0] = position, velocity
    velocities[-1] = 0.0
    return Trajectory(times, positions, velocities)


def reverse_motion(motion: Trajectory) -> Trajectory:
    """The motion from its end to its start."""
    times = motion.times[-1] - motion.times[::-1]
    return Trajectory(times, motion.positions[::-1].copy(), -motion.velocities[::-1] + 0.0)


def _phases(velocity: float, acceleration: float, limit: float, jerk: float) -> tuple[tuple[float, float], ...]:
    rest = velocity + acceleration * abs(acceleration) / (2.0 * jerk)
    sign = -math.copysign(1.0, rest)
    v, a = sign * velocity, sign * acceleration
    peak = math.sqrt(max(0.5 * a * a - jerk * v, max(a, 0.0) ** 2))
    hold = 0.0
    if peak > limit:
        peak = limit
        hold = max((-v - (2.0 * peak * peak - a * a) / (2.0 * jerk)) / peak, 0.0)
    return (max((peak - a) / jerk, 0.0), sign * jerk), (hold, 0.0), (peak / jerk, -sign * jerk)


def _states(
    times: np.ndarray, x: float, v: float, a: float, phases: tuple[tuple[float, float], ...]
) -> tuple[np.ndarray, np.ndarray]:
    positions, velocities = np.empty_like(times), np.empty_like(times)
    begin, done = 0.0, times < 0.0
    for span, jerk in (*phases, (math.inf, 0.0)):
        here = ~done & (times <= begin + span)
        t = times[here] - begin
        positions[here] = x + t * (v + t * (0.5 * a + t * jerk / 6.0))
        velocities[here] = v + t * (a + 0.5 * t * jerk)
        done |= here
        if span < math.inf:
            x += span * (v + span * (0.5 * a + span * jerk / 6.0))
            v += span * (a + 0.5 * span * jerk)
            a += span * jerk
            begin += span
    return positions, velocities
