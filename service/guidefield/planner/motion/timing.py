"""The waypoints of a path, and the time-optimal motion along a curve through them, at rest at both ends.

The optimal speed within the velocity and acceleration limits is found on a grid. The motion is *defined* as the uniform
cubic B-spline in time whose control points are where the curve is at even times. So it keeps the position limits that
the curve keeps, and the means over a piece of what accelerations the optimal motion has. Its extrema are known exactly:
time is scaled so that it reaches a limit and exceeds none. It keeps to the curve but for a sixth of the second
difference of its control points.

Jerk is limited by that scaling alone. The longer its pieces are, the less jerk a motion has, so several lengths are
tried. So no constant of the timing decides whether limits are kept: they change how long a motion takes, how far it is
from the path, and the time to find it. `SHORTEST_PIECE` is that of schedules, too; service/docs/algorithm.md repeats
the last of `PIECES`.

Pieces need some length, so `REPEATED` has to be above 0. A goal within it of the start counts as reached: docs/goals.md
repeats the number, and goals may be missed by more; else first and last waypoint stay bit for bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, cast

import numpy as np

from guidefield.deadline import UNLIMITED, Deadline
from guidefield.kernels.timing import path_parameterization
from guidefield.memo import memoized_by_value
from guidefield.planner.motion.bspline import ENDS, BSpline, End, basis, basis_bends, basis_slopes
from guidefield.planner.motion.limit_load import stretch_to_limits
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.task.motion_limits import CurveLimits, MotionLimit
from guidefield.read_only import ReadOnly, read_only
from guidefield.robot.model.joints import LocalPoint, LocalPoints, LocalRate, LocalRates

# weight of the curve's length against its own parameter, for the steps of the grid. With 0 motions along a line of
# uneven places take up to 15 % longer; with 300 those that turn back up to 10 %
LENGTH_WEIGHT = 300.0
# steps of the grid on each piece of the curve. With 6 motions round many corners take 2 % longer, with 24 they take 1 %
# less and their timing twice as long ..
STEPS_A_PIECE = 10
LEAST_STEPS = 64  # .. and at least this many in all of it. Unrecorded
# numbers of pieces of the motion: the largest; where jerk is limited, that with which it is the shortest. With at most
# 96 motions take 1 % less; with 12 as well those within 50 rad/s³ take 5 % less, but are farther from the path
PIECES = (16, 24, 32, 48, 64)
# no controller follows shorter pieces, and their accelerations, second differences of positions, would be a matter of
# rounding [s]
SHORTEST_PIECE = 2e-4

BEFORE = np.array([-1, 0, 1, 2])  # the control points of a piece, counted from the place at which it begins
# a waypoint at most this far from the one before is the same [rad or m]: a nanometre at a metre's reach
REPEATED = 1e-9


def length_of(path: LocalPoints, units: np.ndarray | float = 1.0) -> float:
    """Length of a path of local coordinates (n, nv), by a group's metric where its units (nv,) are given [rad or m]."""
    along = (path[1:] - path[:-1]) / units
    return float(np.sqrt(np.einsum("ij,ij->i", along, along)).sum())


def lengths_of(path: LocalPoints) -> np.ndarray:
    """Lengths of the straight pieces of a path of local coordinates (n, nv), shape (n - 1,) [rad or m]."""
    along = path[1:] - path[:-1]
    lengths: np.ndarray = np.sqrt((along * along).sum(axis=1))
    return lengths


def remove_repetitions(path: LocalPoints) -> LocalPoints:
    """The waypoints (n, nv) of a path without repetitions, first and last kept; a single one if they are all the same.

    What is within `REPEATED` of the one before repeats it.
    """
    if len(path) > 1 and lengths_of(path).min() > REPEATED:
        return path
    kept = [path[0]]
    for waypoint in path[1:-1]:
        if np.linalg.norm(waypoint - kept[-1]) > REPEATED:
            kept.append(waypoint)
    goal = path[-1]
    while len(kept) > 1 and np.linalg.norm(goal - kept[-1]) <= REPEATED:
        kept.pop()
    if np.linalg.norm(goal - kept[-1]) > REPEATED:
        kept.append(goal)
    return cast(LocalPoints, np.array(kept))


def subdivide(path: LocalPoints, spacing: float, sizes: np.ndarray | float = 1.0) -> LocalPoints:
    """Places along a path (n, nv), its waypoints among them, evenly on each straight piece and at most so far apart.

    There are three at least. Coordinates count by their sizes (nv,), where these are given.
    """
    lengths = lengths_of(cast(LocalPoints, path / sizes))
    parts = np.maximum(np.ceil(lengths / spacing).astype(np.int64), 2 if len(path) == 2 else 1)
    piece = np.repeat(np.arange(len(parts)), parts)
    share = (np.arange(len(piece)) - np.repeat(np.cumsum(parts) - parts, parts)) / parts[piece]
    inner = path[piece] + share[:, None] * (path[piece + 1] - path[piece])
    return cast(LocalPoints, np.concatenate([inner, path[-1:]]))


@dataclass(frozen=True, eq=False)
class PathCurve(ReadOnly):
    """A curve by a parameter without a unit, that grows by 1 on each piece."""

    points: LocalPoints  # control points, shape (m + 3, nv), m pieces; the first and the last stand for the ends' bends
    sizes: np.ndarray | float = 1.0  # by which coordinates count in its length, shape (nv,)

    @classmethod
    def along(cls, places: LocalPoints, sizes: np.ndarray | float = 1.0) -> PathCurve:
        """Along places on a path, shape (m + 1, nv), m >= 1, no two consecutive ones the same."""
        first, last = 2.0 * places[:1] - places[1:2], 2.0 * places[-1:] - places[-2:-1]
        return cls(cast(LocalPoints, np.concatenate([first, places, last])), sizes)

    @property
    def pieces(self) -> int:
        """The number of pieces."""
        return len(self.points) - 3

    def at(self, parameters: np.ndarray) -> LocalPoints:
        """Local coordinates (k, nv) at parameters (k,), from 0 to `pieces`."""
        pieces = np.clip(parameters.astype(np.int64), 0, self.pieces - 1)
        return cast(
            LocalPoints, np.einsum("ka,kaj->kj", basis(parameters - pieces), self.points[pieces[:, None] + 1 + BEFORE])
        )

    def derivatives(self, steps: int) -> tuple[LocalRates, LocalRates]:
        """The first two derivatives by the parameter, at even steps on each piece and at the end.

        Returns:
            Both of shape (pieces * steps + 1, nv) [rad or m].
        """
        about = self.points[np.arange(self.pieces)[:, None] + 1 + BEFORE]
        made = [
            np.concatenate([(of @ about).reshape(-1, self.points.shape[1]), at_end @ about[-1]])
            for of, at_end in zip(_bases(steps), _bases(0), strict=True)
        ]
        return cast(LocalRates, made[0]), cast(LocalRates, made[1])


@memoized_by_value(16)
def _bases(steps: int) -> tuple[np.ndarray, np.ndarray]:
    """The derivatives of the basis at even steps of a piece, shape (steps, 4) each; at its end where 0."""
    shares = np.arange(steps) / steps if steps else np.ones(1)
    made = basis_slopes(shares), basis_bends(shares)
    read_only(*made)
    return made


class Limits(NamedTuple):
    """Limits of a motion: velocities, accelerations and jerks, each of shape (nv,), positive; jerks may be infinite.

    The units are rad/s or m/s, rad/s² or m/s², rad/s³ or m/s³.
    """

    velocity: LocalRate
    acceleration: LocalRate
    jerk: LocalRate
    motion_limits: tuple[MotionLimit, ...] = ()  # limits of the motion as a whole
    deadline: Deadline = UNLIMITED  # after it a motion is slowed down no further for the limits of the whole motion


class CurveProgress(NamedTuple):
    """The progress of a motion along a curve."""

    parameters: np.ndarray  # of the curve, shape (g,)
    times: np.ndarray  # from 0 on, shape (g,) [s]
    rates: np.ndarray  # of the parameter, shape (g,) [1/s]

    @property
    def duration(self) -> float:
        """[s]."""
        return float(self.times[-1])

    def at(self, times: np.ndarray) -> np.ndarray:
        """The parameter at times (k,) [s]: cubic between the grid's times, and never beyond its places there."""
        i = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, len(self.times) - 2)
        span = self.times[i + 1] - self.times[i]
        x, before, after = (times - self.times[i]) / span, self.parameters[i], self.parameters[i + 1]
        rise, first, last = after - before, span * self.rates[i], span * self.rates[i + 1]
        cubic = before + x * (first + x * (3.0 * rise - 2.0 * first - last + x * (first + last - 2.0 * rise)))
        parameters: np.ndarray = np.clip(cubic, before, after)
        return parameters


def parameterize(curve: PathCurve, limits: Limits, finer: int = 1) -> BSpline:
    """The fastest motion along a curve, from rest to rest, that exceeds no limit at any time.

    `stretch_spline_to_limits` makes its trajectory.

    Raises:
        ValueError: if the limits are not one per coordinate and positive, or those of velocity or acceleration are
            infinite.
    """
    _check(curve, limits)
    progress = find_fastest_progress(curve, limits)
    most = max(PIECES[0], int(progress.duration / SHORTEST_PIECE))
    if not np.isfinite(limits.jerk).any():
        return _resample_in_time(curve, progress, min(finer * PIECES[-1], most))
    tried = (_resample_in_time(curve, progress, min(finer * count, most)) for count in PIECES)
    rates = limits._replace(motion_limits=())
    return min(tried, key=lambda spline: stretch_spline_to_limits(spline, rates).duration)


def stretch_spline_to_limits(spline: BSpline, limits: Limits) -> Trajectory:
    """A motion with its time scaled so that it reaches a limit and exceeds none."""
    return stretch_to_limits(*spline.knots(), *limits[:3], limits.motion_limits, limits.deadline)


def find_fastest_progress(curve: PathCurve, limits: Limits) -> CurveProgress:
    """The progress along a curve of the fastest motion within limits of velocity and acceleration.

    Between the points of the grid it may exceed them a little.
    """
    steps = max(STEPS_A_PIECE, -(-LEAST_STEPS // curve.pieces))
    first, second = curve.derivatives(2 * steps)
    first, between, second = first[::2], first[1::2], second[::2]
    # the steps of the grid count in r, with (dr/du)² = 1 + (weight |q'| / its mean)²: nearly the length
    places, counted, bends = (of / curve.sizes for of in (curve.points[1:-1], first, second))
    mean = float(lengths_of(cast(LocalPoints, places)).mean())
    scale = LENGTH_WEIGHT / mean
    rate, rate_between = (np.sqrt(1.0 + ((scale * of) ** 2).sum(axis=1)) for of in (counted, between / curve.sizes))
    bend = scale**2 * (counted * bends).sum(axis=1) / rate**2  # (d²r/du²) / (dr/du)
    parameters = np.arange(len(rate)) / steps
    by_length = (
        cast(LocalRates, first / rate[:, None]),
        cast(LocalRates, (second - first * bend[:, None]) / (rate**2)[:, None]),
    )
    points = curve.at(parameters) if limits.motion_limits else None
    curve_limits = [] if points is None else [limit.along(points, *by_length) for limit in limits.motion_limits]
    # Simpson's rule
    speeds = _find_speeds(*by_length, (rate[:-1] + 4.0 * rate_between + rate[1:]) / (6.0 * steps), limits, curve_limits)
    return CurveProgress(parameters, speeds.times, speeds.rates / rate)


class _Speeds(NamedTuple):
    """Times of the grid's points, and the rates of r there, each of shape (g,)."""

    times: np.ndarray
    rates: np.ndarray


def _find_speeds(
    first: LocalRates, second: LocalRates, steps: np.ndarray, limits: Limits, curve_limits: Sequence[CurveLimits]
) -> _Speeds:
    # where the curve all but stands still in r no speed is too large for the velocities; the accelerations decide
    slowness = np.maximum((np.abs(first) / limits.velocity).max(axis=1), 1e-30)
    accelerations = np.empty((len(steps), len(limits.acceleration)))
    accelerations[:] = limits.acceleration
    offsets = np.zeros_like(accelerations)
    caps, on_u, on_x = slowness**-2.0, cast(np.ndarray, first), cast(np.ndarray, second)
    if curve_limits:
        caps = np.minimum.reduce([caps, *(one.caps for one in curve_limits)])
        on_u, on_x = (
            np.hstack([on_u, *(one.on_u for one in curve_limits)]),
            np.hstack([on_x, *(one.on_x for one in curve_limits)]),
        )
        below, above = (
            np.hstack([accelerations, *(np.minimum(rows[:-1], rows[1:]) for rows in sides)])
            for sides in ([one.below for one in curve_limits], [one.above for one in curve_limits])
        )
        accelerations, offsets = 0.5 * (below + above), (below - above) / (below + above)
    controllable, squares = np.empty(len(slowness)), np.empty(len(slowness))
    path_parameterization.fastest_speeds(on_u, on_x, steps, caps, accelerations, offsets, controllable, squares)
    rates = np.sqrt(squares)
    times = np.zeros(len(rates))
    np.cumsum(2.0 * steps / (rates[:-1] + rates[1:]), out=times[1:])  # d²r/dt² is constant
    return _Speeds(times, rates)


def _resample_in_time(curve: PathCurve, progress: CurveProgress, pieces: int) -> BSpline:
    """The motion of some pieces with control points where the curve is at even times; two pieces longer."""
    step = progress.duration / (pieces - 2)
    inner = curve.at(progress.at(step * np.arange(1, pieces - ENDS + 1)))
    start, end = (End.at_rest(cast(LocalPoint, curve.points[row])) for row in (1, -2))
    return BSpline.between(start, end, inner, step)


def _check(curve: PathCurve, limits: Limits) -> None:
    nv = curve.points.shape[1]
    for kind, values in zip(Limits._fields[:3], limits[:3], strict=True):
        kept: np.ndarray = np.asarray(values, float)
        if kept.shape != (nv,) or not (kept > 0.0).all() or (kind != "jerk" and not np.isfinite(kept).all()):
            finite = "" if kind == "jerk" else "finite and "
            raise ValueError(f"expected {nv} {finite}positive {kind} limits, got {kept}")
