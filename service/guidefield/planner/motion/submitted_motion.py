"""A given or drawn motion as the curve to certify: Hermite or quintic knots, samples, waypoints, or steps.

Knots with velocities are the cubic Hermite curve through them. Through samples in time goes the cubic spline whose
accelerations are continuous: a robot can't follow a step of velocity, and where the samples are of a smooth motion the
spline is off by the fourth power of their distance only. Waypoints are joined by straight pieces. Verdicts are about
these curves, and docs/certify.md states them: another formula would be another promise.
"""

from __future__ import annotations

import dataclasses
import enum
from dataclasses import dataclass
from functools import cached_property
from typing import Any, cast

import numpy as np

from guidefield.kernels.timing import hermite as not_a_knot
from guidefield.kernels.timing.carried_rates import MotionPolynomials
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.task.motion_limits import polynomials_of
from guidefield.prove.curve import Curve, find_pieces, point_on, polyline
from guidefield.read_only import ReadOnly, read_only
from guidefield.robot.model.joints import LocalCurves, LocalPoint, LocalPoints, LocalRates
from guidefield.scene.scene import Scene

SHORTEST = 1e-3  # least time of a straight piece of a path without times, where only the order of places counts


class CurveKind(enum.Enum):
    """The kind of curve to certify; the values are the words of replies."""

    HERMITE = "hermite"
    SPLINE = "spline"
    LINEAR = "linear"
    QUINTIC = "quintic"
    STEPS = "steps"


@dataclass(frozen=True, eq=False)
class StraightMotion(ReadOnly):
    """Straight pieces, each run through evenly: the velocity jumps at knots."""

    times: np.ndarray  # shape (n,), n >= 2, strictly increasing [s]
    positions: LocalPoints  # local coordinates, shape (n, nv) [rad or m]

    @property
    def duration(self) -> float:
        """[s]."""
        return float(self.times[-1] - self.times[0])

    def bezier(self) -> LocalCurves:
        """Control points of the pieces, shape (n - 1, 2, nv) [rad or m]."""
        return polyline(self.positions)

    def piece_times(self) -> np.ndarray:
        """Times at which they begin, and the last one ends, shape (n,) [s]."""
        return self.times.copy()

    def evaluate(self, times: np.ndarray) -> tuple[LocalPoints, LocalRates]:
        """Local coordinates and rates at times (k,) [s], both of shape (k, nv) [rad or m, and per s]."""
        piece = np.searchsorted(self.times[1:-1], times, side="right")
        rates = np.diff(self.positions, axis=0) / np.diff(self.times)[:, None]
        return self.positions[piece] + (times - self.times[piece])[:, None] * rates[piece], rates[piece]


@dataclass(frozen=True, eq=False)
class QuinticMotion(ReadOnly):
    """Pieces of degree 5 with the positions, velocities and accelerations of both their knots."""

    times: np.ndarray  # shape (n,), n >= 2, strictly increasing [s]
    positions: LocalPoints  # local coordinates, shape (n, nv) [rad or m]
    velocities: LocalRates  # shape (n, nv) [rad/s or m/s]
    accelerations: LocalRates  # shape (n, nv) [rad/s² or m/s²]

    @property
    def duration(self) -> float:
        """[s]."""
        return float(self.times[-1] - self.times[0])

    def bezier(self) -> LocalCurves:
        """Control points of the pieces, shape (n - 1, 6, nv) [rad or m]."""
        return self._bezier

    @cached_property
    def _bezier(self) -> LocalCurves:
        spans = np.diff(self.times)[:, None]
        start, end = self.positions[:-1], self.positions[1:]
        v, w, a, b = self.velocities[:-1], self.velocities[1:], self.accelerations[:-1], self.accelerations[1:]
        curves = np.stack(
            [
                start,
                start + spans / 5.0 * v,
                start + spans * (0.4 * v + spans / 20.0 * a),
                end - spans * (0.4 * w - spans / 20.0 * b),
                end - spans / 5.0 * w,
                end,
            ],
            axis=1,
        )
        read_only(curves)
        return cast(LocalCurves, curves)

    def rates(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Control points of velocities, accelerations and jerks, shapes (n - 1, 5, nv), (n - 1, 4, nv), (n - 1, 3, nv).

        Those at the ends are the knots' own; the middle one of the velocities makes their mean that of the piece.
        """
        spans = np.diff(self.times)[:, None]
        v, w, a, b = self.velocities[:-1], self.velocities[1:], self.accelerations[:-1], self.accelerations[1:]
        second, fourth = v + spans / 4.0 * a, w - spans / 4.0 * b
        middle = 5.0 * np.diff(self.positions, axis=0) / spans - v - second - fourth - w
        velocities = np.stack([v, second, middle, fourth, w], axis=1)
        inner = 4.0 * np.diff(velocities[:, 1:4], axis=1) / spans[:, None]
        accelerations = np.concatenate([a[:, None], inner, b[:, None]], axis=1)
        return velocities, accelerations, 3.0 * np.diff(accelerations, axis=1) / spans[:, None]

    def piece_times(self) -> np.ndarray:
        """Times at which they begin, and the last one ends, shape (n,) [s]."""
        return self.times.copy()

    def evaluate(self, times: np.ndarray) -> tuple[LocalPoints]:
        """Local coordinates at times (k,) [s], shape (k, nv) [rad or m]."""
        return (Curve(self.bezier(), self.times).at(times),)


@dataclass(frozen=True, eq=False)
class SubmittedMotion(ReadOnly):
    """A curve through the rows of a motion, or through those that a controller is sent; and a tube about it.

    Steps (`CurveKind.STEPS`) from one position to the next may have every joint anywhere between both.
    """

    kind: CurveKind
    positions: (
        LocalPoints  # local coordinates at the knots, shape (n, nv), no two consecutive ones at one time [rad or m]
    )
    # which of the given rows each knot is, shape (n,), or where between them; the last is the last one
    rows: np.ndarray
    times: np.ndarray | None = None  # of the knots, shape (n,), strictly increasing [s]; None where there are none
    velocities: LocalRates | None = None  # at the knots, shape (n, nv) [rad/s or m/s]; None of straight pieces
    # of a quintic; of a single knot, which has no curve to tell them, as given, shape (k, nv) [rad/s² or
    # m/s²]; else None
    accelerations: LocalRates | None = None
    tolerance: np.ndarray | None = None  # how far a robot may be from it, shape (nv,) [rad or m]; None: nothing

    @classmethod
    def through(
        cls,
        times: np.ndarray | None,
        positions: np.ndarray,
        velocities: np.ndarray | None = None,
        accelerations: np.ndarray | None = None,
        tolerance: np.ndarray | None = None,
        *,
        steps: bool = False,
    ) -> SubmittedMotion:
        """The curve through rows, by what they have: straight, cubic by velocities, of degree 5 by accelerations, too.

        Times (n,) [s], all others of shape (n, nv), but for the tolerance (nv,), as `SubmittedMotion` has them.
        """
        kind = CurveKind.HERMITE if accelerations is None else CurveKind.QUINTIC
        if velocities is None:
            kind = CurveKind.STEPS if steps else CurveKind.LINEAR
        rate, rise = (cast("LocalRates | None", one) for one in (velocities, accelerations))
        return cls(kind, cast(LocalPoints, positions), np.arange(len(positions)), times, rate, rise, tolerance)

    @classmethod
    def of(cls, motion: Trajectory, tolerance: np.ndarray | None = None) -> SubmittedMotion:
        """A trajectory as it is, with a tolerance (nv,) about it."""
        return cls.through(motion.times, motion.positions, motion.velocities, tolerance=tolerance)

    @property
    def is_point(self) -> bool:
        """True if there is a single knot."""
        return len(self.positions) == 1

    @property
    def duration(self) -> float:
        """[s]; 0 without times."""
        return 0.0 if self.times is None else float(self.times[-1] - self.times[0])

    @cached_property
    def pieces(self) -> LocalCurves:
        """Bezier control points, shape (m, k, nv), m = max(n - 1, 1): the curve to certify [rad or m].

        Steps stand in the middle of the box that they are in.
        """
        if self.kind is CurveKind.STEPS:
            return np.repeat(self.straight.mean(axis=1, keepdims=True), 2, axis=1)
        if self.velocities is None or self.times is None:
            return polyline(self.positions)
        return cast(LocalCurves, self.measured.bezier())

    @cached_property
    def straight(self) -> LocalCurves:
        """Control points of straight pieces between the knots, shape (m, 2, nv) [rad or m]."""
        return polyline(self.positions)

    @cached_property
    def tube(self) -> np.ndarray | None:
        """Half widths of the box about each piece in which the robot is, shape (m, nv) [rad or m]; None: nothing."""
        if self.kind is not CurveKind.STEPS:
            return None if self.tolerance is None else np.tile(self.tolerance, (len(self.pieces), 1))
        steps = 0.5 * np.abs(self.straight[:, 1] - self.straight[:, 0])
        return steps if self.tolerance is None else steps + self.tolerance

    @cached_property
    def measured(self) -> Trajectory | StraightMotion | QuinticMotion:
        """The same places in the same order, for the smallest distances to obstacles that rest.

        Straight pieces begin and end at rest here, which makes the rates continuous and leaves the places unchanged;
        those without times take as long as their length. Steps are straight pieces.
        """
        if self.quintic is not None:
            return self.quintic
        if self.velocities is not None and self.times is not None:
            return Trajectory(self.times, self.positions, self.velocities)
        times = self.times
        if times is None:
            lengths = np.linalg.norm(np.diff(self.positions, axis=0), axis=1)
            times = np.concatenate([[0.0], np.cumsum(np.maximum(lengths, SHORTEST))])
        return Trajectory(times, self.positions, cast(LocalRates, np.zeros(self.positions.shape)))

    @cached_property
    def quintic(self) -> QuinticMotion | None:
        """The motion if it is of degree 5, with two knots at least."""
        if self.kind is not CurveKind.QUINTIC or self.is_point:
            return None
        assert self.times is not None, "it has times"
        assert self.velocities is not None, "it has velocities"
        assert self.accelerations is not None, "it has accelerations"
        return QuinticMotion(self.times, self.positions, self.velocities, self.accelerations)

    @cached_property
    def scheduled(self) -> Trajectory | StraightMotion | QuinticMotion:
        """The motion as it is in time: among obstacles that move.

        Raises:
            ValueError: if it has no times.
        """
        if self.times is None:
            raise ValueError("a path has no times")
        if self.velocities is not None or self.is_point:
            return self.measured
        return StraightMotion(self.times, self.positions)

    @cached_property
    def polynomials(self) -> MotionPolynomials:
        """The motion as it is in time, by powers of it: of straight pieces the velocities jump.

        Raises:
            ValueError: if it has no times, or steps.
        """
        if self.kind is CurveKind.STEPS:
            raise ValueError("steps take no time")
        motion = self.scheduled
        return motion.polynomials if isinstance(motion, Trajectory) else polynomials_of(motion.bezier(), motion.times)

    def measured_among(self, scene: Scene) -> Trajectory | StraightMotion | QuinticMotion:
        """The motion to measure the distances from a scene of: in time where that moves."""
        return self.scheduled if scene.moves else self.measured

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

    def place_at(self, time: float) -> tuple[int, float]:
        """The piece that is run through at a time [s], and the share of it that has passed; times are needed."""
        assert self.times is not None, "it has times"
        if self.is_point:
            return 0, 0.0
        piece, share = find_pieces(self.times, np.array([time]))
        return int(piece[0]), float(share[0])

    def between(self, begin: tuple[int, float], end: tuple[int, float]) -> SubmittedMotion:
        """The part between two places, each a piece and the share of it that has passed; steps aren't cut."""
        if self.is_point:
            return self
        (first, share), (last, until) = begin, end
        if share == 1.0 and first + 1 < len(self.pieces):
            first, share = first + 1, 0.0
        if until == 0.0 and last > first:
            last, until = last - 1, 1.0
        if (first, share) == (last, until):
            cut = [self._state(first, share)]
        else:
            rows = range(first, last + 2)
            cut = [self._state(k, 0.0) if k <= last else self._state(last, 1.0) for k in rows]
            if share > 0.0:
                cut[0] = self._state(first, share)
            if until < 1.0:
                cut[-1] = self._state(last, until)
        columns = [None if any(one is None for one in some) else np.array(some) for some in zip(*cut, strict=True)]
        row_numbers, times, positions, velocities, accelerations = columns
        return dataclasses.replace(
            self,
            positions=cast(LocalPoints, positions),
            rows=cast(np.ndarray, row_numbers),
            times=times,
            velocities=cast("LocalRates | None", velocities),
            accelerations=cast("LocalRates | None", accelerations),
        )

    def _state(self, piece: int, share: float) -> tuple[float, float | None, LocalPoint, Any, Any]:
        """Row, time, position, and where there are rates, velocity and acceleration at a place."""
        row, time = self.along(piece, share)
        if share in (0.0, 1.0):  # unchanged
            k = piece + int(share)
            velocity, rise = (None if one is None else one[k] for one in (self.velocities, self.accelerations))
            return row, time, cast(LocalPoint, self.positions[k]), velocity, rise
        assert self.kind is not CurveKind.STEPS, "steps aren't cut"
        controls = self.pieces[piece]
        if self.velocities is None or self.times is None:
            return row, time, point_on(controls, share), None, None
        order, span = len(controls) - 1, float(self.times[piece + 1] - self.times[piece])
        first = cast(LocalPoints, order * np.diff(controls, axis=0) / span)
        second = cast(LocalPoints, (order - 1) * np.diff(first, axis=0) / span)
        rise = None if self.accelerations is None else point_on(second, share)
        return row, time, point_on(controls, share), point_on(first, share), rise

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
    def start(self) -> LocalPoint:
        """Local coordinates of its beginning, shape (nv,)."""
        point: LocalPoint = self.positions[0]
        return point


def spline_rates(times: np.ndarray, positions: LocalPoints) -> LocalRates:
    """Rates at samples (n, nv) of the cubic through them with continuous accelerations, not-a-knot at its ends.

    It is a line through two samples, a parabola through three.
    """
    rates = cast(LocalRates, np.zeros(positions.shape))
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
