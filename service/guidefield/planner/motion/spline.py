"""Natural cubic spline through the waypoints of a path, within limits: the curve without its timing."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from guidefield.kernels.timing import natural_spline
from guidefield.planner.motion.settings import SPLINE
from guidefield.planner.motion.within_limits import leaving, smoothly_within
from guidefield.read_only import ReadOnly
from guidefield.robot.model.spaces import ChartCurves, ChartPoint, ChartPoints, ChartRates


@dataclass(frozen=True, eq=False)
class CubicSpline(ReadOnly):
    """A curve that is cubic between knots, twice continuously differentiable, and straight (q'' = 0) at its ends.

    A coordinate that would leave its limits is brought within them, and need not be straight at its ends then.

    Attributes:
        knots: Parameter values s of the waypoints, shape (m + 1,), strictly increasing from 0; no unit of its own.
        waypoints: Chart coordinates at the knots, shape (m + 1, nv) [rad or m].
        coefficients: Shape (m, 4, nv): ``q(s) = sum_k coefficients[i, k] (s - knots[i])**k`` on piece i.
        lower, upper: Limits that it keeps, shape (nv,) [rad or m]; infinite where there are none.
    """

    knots: np.ndarray
    waypoints: ChartPoints
    coefficients: np.ndarray
    lower: ChartPoint
    upper: ChartPoint

    @property
    def is_point(self) -> bool:
        """Whether the curve stays where it starts."""
        return bool(np.all(self.waypoints == self.waypoints[0]))

    def evaluate(self, s: np.ndarray) -> tuple[ChartPoints, ChartRates, ChartRates]:
        """The curve and its first two derivatives by the parameter.

        Args:
            s: Parameter values, shape (k,), each between the first and the last knot.

        Returns:
            q, q' and q'', each of shape (k, nv); q is exactly the waypoint where s is exactly its knot.

        Raises:
            ValueError: if a parameter value lies outside the curve.
        """
        s = np.asarray(s, dtype=float)
        if s.size and not (s.min() >= self.knots[0] and s.max() <= self.knots[-1]):
            raise ValueError(f"the curve runs from s = 0 to {self.knots[-1]}; asked for {s.min()} to {s.max()}")
        piece = np.searchsorted(self.knots[1:-1], s, side="right")
        c = self.coefficients[piece]
        r = (s - self.knots[piece])[:, None]
        q = c[:, 0] + r * (c[:, 1] + r * (c[:, 2] + r * c[:, 3]))
        q[s == self.knots[-1]] = self.waypoints[-1]
        return q, c[:, 1] + r * (2.0 * c[:, 2] + 3.0 * r * c[:, 3]), 2.0 * c[:, 2] + 6.0 * r * c[:, 3]

    def bezier(self) -> ChartCurves:
        """Control points of the pieces, shape (m, 4, nv): the same curve, inside their convex hulls [rad or m]."""
        h = np.diff(self.knots)[:, None]
        c = self.coefficients
        third = c[:, 1] * h / 3.0
        end = c[:, 1] * h + 2.0 * c[:, 2] * h**2 + 3.0 * c[:, 3] * h**3  # h q' at the piece's end
        start, stop = self.waypoints[:-1], self.waypoints[1:]
        return np.stack([start, start + third, stop - end / 3.0, stop], axis=1)


def interpolate(
    waypoints: ChartPoints, lower: ChartPoint | float = -np.inf, upper: ChartPoint | float = np.inf
) -> CubicSpline:
    """The natural cubic spline through waypoints, its knots spaced by the square root of the chords.

    A coordinate that would leave its limits between waypoints that keep them is brought within, and passes inner
    waypoints by for that; the other coordinates, and both ends, stay what they are.

    That spacing ("centripetal") is used because a path is known to be free along its polyline only, and the curve
    swings away from it less. For unevenly spaced waypoints (7 joints, 40 paths a kind, medians) the largest distance to
    the polyline was 129 mrad on a smooth path with chords over two decades, 68 with a corner at every waypoint, 5 with
    one pair of waypoints 10 mrad apart; with knots spaced by the chords themselves 277, 155 and 20, and with powers in
    between, in between. For evenly spaced waypoints there is no difference.

    Waypoints that repeat the one before, within `SPLINE.repeated`, are left out, though never the first or the last; a
    path that never leaves its first waypoint by more is one constant piece over [0, 1].

    Args:
        waypoints: Chart coordinates in order, shape (n, nv), n >= 2 [rad or m].
        lower: Limits of each coordinate, shape (nv,), or of all [rad or m].
        upper: The same.

    Raises:
        ValueError: if there are fewer than two waypoints, or a value is not finite.
    """
    waypoints = np.asarray(waypoints, dtype=float)
    if waypoints.ndim != 2 or len(waypoints) < 2:
        raise ValueError(f"expected at least two waypoints in an array (n, nv), got shape {waypoints.shape}")
    if not np.isfinite(waypoints).all():
        raise ValueError("waypoints have to be finite")
    lower, upper = (np.broadcast_to(limit, waypoints.shape[1:]).astype(float) for limit in (lower, upper))
    distinct = _distinct(waypoints)
    if len(distinct) == 1:
        standing = np.zeros((1, 4, waypoints.shape[1]))
        standing[0, 0] = distinct[0]
        return CubicSpline(np.array([0.0, 1.0]), np.repeat(distinct, 2, axis=0), standing, lower, upper)
    h = np.sqrt(np.linalg.norm(np.diff(distinct, axis=0), axis=1))
    knots = np.concatenate([[0.0], np.cumsum(h)])
    return _within(CubicSpline(knots, distinct, _coefficients(np.diff(knots), distinct), lower, upper))


def _distinct(waypoints: ChartPoints) -> ChartPoints:
    """The waypoints without repetitions, first and last kept; a single one if they are all the same."""
    if np.linalg.norm(np.diff(waypoints, axis=0), axis=1).min() > SPLINE.repeated:
        return waypoints.copy()
    kept = [waypoints[0]]
    for waypoint in waypoints[1:-1]:
        if np.linalg.norm(waypoint - kept[-1]) > SPLINE.repeated:
            kept.append(waypoint)
    goal = waypoints[-1]
    while len(kept) > 1 and np.linalg.norm(goal - kept[-1]) <= SPLINE.repeated:
        kept.pop()
    if np.linalg.norm(goal - kept[-1]) > SPLINE.repeated:
        kept.append(goal)
    return np.array(kept)


def _coefficients(h: np.ndarray, waypoints: ChartPoints) -> np.ndarray:
    """Coefficients of the pieces, shape (m, 4, nv), from the steps of the knots and the waypoints."""
    second = np.empty_like(waypoints)
    natural_spline.second_derivatives(h, waypoints, np.empty(len(waypoints)), second)
    h = h[:, None]
    slope = np.diff(waypoints, axis=0) / h - h * (2.0 * second[:-1] + second[1:]) / 6.0
    return np.stack([waypoints[:-1], slope, second[:-1] / 2.0, np.diff(second, axis=0) / (6.0 * h)], axis=1)


def _within(spline: CubicSpline) -> CubicSpline:
    """The curve brought within its limits; those coordinates that keep them stay what they are."""
    slopes = np.vstack([spline.coefficients[:, 1], spline.evaluate(spline.knots[-1:])[1]])
    changed = leaving(spline.knots, spline.waypoints, slopes, spline.lower, spline.upper)
    if not changed.any():
        return spline
    waypoints, coefficients = spline.waypoints.copy(), spline.coefficients.copy()
    values, slopes = smoothly_within(
        spline.knots, waypoints[:, changed], slopes[:, changed], spline.lower[changed], spline.upper[changed]
    )
    h = np.diff(spline.knots)[:, None]
    mean, start, end = np.diff(values, axis=0) / h, slopes[:-1], slopes[1:]
    second, third = (3.0 * mean - 2.0 * start - end) / h, (start + end - 2.0 * mean) / h**2
    waypoints[:, changed] = values
    coefficients[:, :, changed] = np.stack([values[:-1], start, second, third], axis=1)
    return replace(spline, waypoints=waypoints, coefficients=coefficients)
