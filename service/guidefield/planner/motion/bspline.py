"""A motion as a uniform cubic B-spline in time: control points, and the length of its pieces.

The ends' three control points follow from position, velocity and acceleration there; optimisation moves the inner ones.
Kernels (timing, optimize) use the same basis and ends: no formula here may change alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np

from guidefield.kernels.timing.hermite import spline_points, spline_slopes
from guidefield.read_only import ReadOnly
from guidefield.robot.model.joints import LocalPoint, LocalPoints, LocalRate, LocalRates

ENDS = 3  # control points that an end takes, for its position, velocity and acceleration: no setting


def basis(t: np.ndarray) -> np.ndarray:
    """The uniform cubic B-spline's basis at fractions t (k,) of a piece: shape (k, 4)."""
    s = 1.0 - t
    return np.column_stack([s**3, 3.0 * t**3 - 6.0 * t**2 + 4.0, 3.0 * s**3 - 6.0 * s**2 + 4.0, t**3]) / 6.0


def basis_slopes(t: np.ndarray) -> np.ndarray:
    """The derivatives of `basis` by t (k,): shape (k, 4)."""
    s = 1.0 - t
    return np.column_stack([-(s**2), 3.0 * t**2 - 4.0 * t, 4.0 * s - 3.0 * s**2, t**2]) / 2.0


def basis_bends(t: np.ndarray) -> np.ndarray:
    """The second derivatives of `basis` by t (k,): shape (k, 4)."""
    s = 1.0 - t
    return np.column_stack([s, 3.0 * t - 2.0, 3.0 * s - 2.0, t])


@dataclass(frozen=True, eq=False)
class End(ReadOnly):
    """The state at an end of a motion."""

    position: LocalPoint  # shape (nv,) [rad or m]
    velocity: LocalRate  # shape (nv,) [rad/s or m/s]
    acceleration: LocalRate  # shape (nv,) [rad/s² or m/s²]

    @classmethod
    def at_rest(cls, position: LocalPoint) -> End:
        """At rest at local coordinates (nv,), and without acceleration."""
        still = cast(LocalRate, np.zeros_like(position))
        return cls(position, still, still)

    def put_points(self, step: float, points_out: LocalPoints) -> None:
        """Write the three control points about it, for pieces of a length [s], shape (3, nv).

        Where the basis is (1, 4, 1) / 6 its derivatives are (-1, 0, 1) / (2 h) and (1, -2, 1) / h².
        """
        middle = self.position - step**2 / 6.0 * self.acceleration
        across, bend = step * self.velocity, 0.5 * step**2 * self.acceleration
        points_out[0], points_out[1], points_out[2] = middle + bend - across, middle, middle + bend + across


@dataclass(frozen=True, eq=False)
class BSpline(ReadOnly):
    """A uniform cubic B-spline in time, from one end to the other."""

    points: LocalPoints  # control points, shape (m + 3, nv), m pieces [rad or m]
    step: float  # length of a piece [s]
    start: End  # its ends, which the first three and the last three control points are about
    end: End
    begin: float = 0.0  # when it begins [s]

    @classmethod
    def between(cls, start: End, end: End, inner: LocalPoints, step: float, begin: float = 0.0) -> BSpline:
        """With inner control points, shape (m - 3, nv), and pieces of a length, from a time on [s]."""
        points = cast(LocalPoints, np.empty((len(inner) + 2 * ENDS, len(start.position))))
        start.put_points(step, points[:ENDS])
        points[ENDS:-ENDS] = inner
        end.put_points(step, points[-ENDS:])
        return cls(points, step, start, end, begin)

    @property
    def pieces(self) -> int:
        """The number of pieces."""
        return len(self.points) - 3

    @property
    def inner(self) -> LocalPoints:
        """The control points between the ends', shape (m - 3, nv)."""
        return self.points[ENDS:-ENDS]

    @property
    def duration(self) -> float:
        """[s]."""
        return self.pieces * self.step

    def piece_of(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The piece of each place (k,), in pieces from the start, and the fraction of it: both of shape (k,)."""
        pieces = np.clip(places.astype(np.int64), 0, self.pieces - 1)
        return pieces, places - pieces

    def at(self, places: np.ndarray) -> LocalPoints:
        """Local coordinates (k, nv) at places (k,), in pieces from the start."""
        found = np.empty((len(places), self.points.shape[1]))
        spline_points(self.points, places, found)
        return cast(LocalPoints, found)

    def slopes(self, places: np.ndarray) -> LocalPoints:
        """Derivatives (k, nv) by the place, at places (k,), in pieces from the start [rad or m]."""
        found = np.empty((len(places), self.points.shape[1]))
        spline_slopes(self.points, places, found)
        return cast(LocalPoints, found)

    def blend(self, other: BSpline, share: float) -> BSpline:
        """At a share of the way to another one of the same ends and as many pieces; the step goes by its logarithm."""
        points = cast(LocalPoints, self.inner + share * (other.inner - self.inner))
        step, begin = self.step * (other.step / self.step) ** share, self.begin + share * (other.begin - self.begin)
        return BSpline.between(self.start, self.end, points, step, begin)

    def subdivide(self) -> BSpline:
        """The same curve with twice the pieces (Lane and Riesenfeld's rule for cubics)."""
        P = self.points
        finer = np.empty((2 * len(P) - 3, P.shape[1]))
        finer[::2] = 0.5 * (P[:-1] + P[1:])
        finer[1::2] = 0.125 * (P[:-2] + 6.0 * P[1:-1] + P[2:])
        return BSpline.between(self.start, self.end, cast(LocalPoints, finer[ENDS:-ENDS]), 0.5 * self.step, self.begin)

    def waypoints(self) -> LocalPoints:
        """The points at which pieces meet, shape (m + 1, nv)."""
        P = self.points
        positions = (P[:-2] + 4.0 * P[1:-1] + P[2:]) / 6.0
        positions[0], positions[-1] = self.start.position, self.end.position
        return positions

    def knots(self) -> tuple[np.ndarray, LocalPoints, LocalRates]:
        """Times since it begins (m + 1,), positions, velocities (m + 1, nv) where pieces meet: Hermite's curve."""
        P, positions = self.points, self.waypoints()
        velocities = cast(LocalRates, (P[2:] - P[:-2]) / (2.0 * self.step))
        velocities[0], velocities[-1] = self.start.velocity, self.end.velocity
        return self.step * np.arange(self.pieces + 1), positions, velocities
