"""Time-optimal timing of a curve: as fast as the velocity and acceleration limits allow, at rest at both ends.

First the optimal speed along the spline is found on a grid that contains the spline's knots, because its third
derivative jumps there. Then the motion is *defined* as the cubic Hermite curve in time through the grid points. Its
extrema are known exactly, so the limits are kept everywhere and not at samples only: the limits of the steps that came
out too fast are tightened, and what excess remains is removed by stretching all time. The motion leaves the spline by a
few microradians on a smooth path, by up to 0.3 milliradians near sharp corners; never beyond the spline's limits.
"""

from __future__ import annotations

import math
from typing import NamedTuple, cast

import numpy as np

from guidefield.kernels.timing import hermite, path_parameterization
from guidefield.planner.motion.settings import TIMING
from guidefield.planner.motion.spline import CubicSpline
from guidefield.planner.motion.trajectory import Trajectory, piece_accelerations
from guidefield.planner.motion.within_limits import bounded_slopes, leaving
from guidefield.robot.model.spaces import ChartPoints, ChartRate, ChartRates


class _Curve(NamedTuple):
    """A spline at the g points of a grid, by its own parameter.

    Attributes:
        positions: q, shape (g, nv).
        first: q', shape (g, nv).
        second: q'', shape (g, nv).
        steps: Differences of s, shape (g - 1,).
        between: q' in the middle of the steps, shape (g - 1, nv).
        mean_rate: Mean of |q'|, about.
    """

    positions: ChartPoints
    first: ChartRates
    second: ChartRates
    steps: np.ndarray
    between: ChartRates
    mean_rate: float


class _Path(NamedTuple):
    """The same by r: q, dq/dr and d²q/dr², each of shape (g, nv), and the differences of r, shape (g - 1,)."""

    positions: ChartPoints
    first: ChartRates
    second: ChartRates
    steps: np.ndarray


class _Motion(NamedTuple):
    """Knots of a motion, and how many times its limit each joint reaches on each piece, each (n - 1, nv)."""

    times: np.ndarray
    positions: ChartPoints
    velocities: ChartRates
    speed_loads: np.ndarray
    acceleration_loads: np.ndarray

    @property
    def load(self) -> float:
        """The factor by which time has to be stretched to exceed no limit; below 1 there is nothing to do."""
        return max(float(self.speed_loads.max()), math.sqrt(float(self.acceleration_loads.max())))

    @property
    def stretched_duration(self) -> float:
        """Its duration once it exceeds no limit [s]; infinite where it stands still between two knots."""
        duration = float(self.times[-1])
        return duration * max(self.load, 1.0) if math.isfinite(duration) else math.inf


class _Limits(NamedTuple):
    """Limits of velocity and acceleration, of every joint (nv,) or of every joint over each step (g - 1, nv)."""

    velocity: np.ndarray
    acceleration: np.ndarray


def parameterize(spline: CubicSpline, velocity_limits: ChartRate, acceleration_limits: ChartRate) -> Trajectory:
    """The fastest motion along a spline, from rest to rest, that exceeds no limit at any time.

    Args:
        spline: The curve, in chart coordinates [rad or m].
        velocity_limits: Shape (nv,), finite and positive [rad/s or m/s].
        acceleration_limits: Shape (nv,), finite and positive [rad/s² or m/s²].

    Returns:
        The motion; a single knot if the spline is a point.

    Raises:
        ValueError: if the limits are not one per coordinate, finite and positive.
    """
    nv = spline.waypoints.shape[1]
    limits = _Limits(_checked("velocity", velocity_limits, nv), _checked("acceleration", acceleration_limits, nv))
    if spline.is_point:
        still = cast(ChartRates, np.zeros((1, nv)))
        return Trajectory(np.zeros(1), spline.waypoints[:1].copy(), still)
    return _stretched(_within(_fastest(spline, limits)[1], spline, limits), limits)


def fastest(
    spline: CubicSpline, velocity_limits: ChartRate, acceleration_limits: ChartRate
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The spline's parameter s over time in the fastest motion, before its last traces of excess are removed.

    Args:
        spline: The curve, not a point.
        velocity_limits: As in `parameterize`.
        acceleration_limits: As in `parameterize`.

    Returns:
        s, the times [s] and ds/dt [1/s] at the points of a grid, each of shape (g,).
    """
    grid, motion = _fastest(spline, _Limits(velocity_limits, acceleration_limits))
    first = spline.evaluate(grid)[1]
    return grid, motion.times, (first * motion.velocities).sum(axis=1) / np.maximum((first**2).sum(axis=1), 1e-300)


def _fastest(spline: CubicSpline, limits: _Limits) -> tuple[np.ndarray, _Motion]:
    """The optimal motion, and its grid."""
    grid = _first_grid(spline)
    curve = _sampled(spline, grid)
    drafts = [(weight, _timed(_path(curve, weight), limits, limits)) for weight in TIMING.arc_length_weights]
    weight, draft = min(drafts, key=lambda d: d[1].stretched_duration)
    finer = _divided(grid, draft, limits)
    return finer, _optimal(_path(_sampled(spline, finer), weight), limits)


def _checked(kind: str, limits: ChartRate, nv: int) -> ChartRate:
    limits = np.asarray(limits, dtype=float)
    if limits.shape != (nv,) or not (np.isfinite(limits).all() and (limits > 0.0).all()):
        raise ValueError(f"expected {nv} finite and positive {kind} limits, got {limits}")
    return limits


def _sampled(spline: CubicSpline, grid: np.ndarray) -> _Curve:
    """The spline at the points of a grid, and halfway between them."""
    s = np.empty(2 * len(grid) - 1)
    s[::2] = grid
    s[1::2] = (grid[:-1] + grid[1:]) / 2.0
    q, first, second = spline.evaluate(s)
    chords = np.linalg.norm(np.diff(spline.waypoints, axis=0), axis=1)
    return _Curve(q[::2].copy(), first[::2], second[::2], np.diff(grid), first[1::2], chords.sum() / spline.knots[-1])


def _path(curve: _Curve, arc_length_weight: float) -> _Path:
    """The curve by r."""
    scale = arc_length_weight / curve.mean_rate
    rate = np.sqrt(1.0 + ((scale * curve.first) ** 2).sum(axis=1))  # dr/ds
    rate_between = np.sqrt(1.0 + ((scale * curve.between) ** 2).sum(axis=1))
    change = scale**2 * (curve.first * curve.second).sum(axis=1) / rate**2  # (d²r/ds²) / (dr/ds)
    by_r = curve.first / rate[:, None]
    second = (curve.second - curve.first * change[:, None]) / (rate**2)[:, None]
    steps = curve.steps * (rate[:-1] + 4.0 * rate_between + rate[1:]) / 6.0  # Simpson's rule
    return _Path(curve.positions, by_r, second, steps)


def _first_grid(spline: CubicSpline) -> np.ndarray:
    """Equal steps in every piece of the spline."""
    pieces = len(spline.knots) - 1
    parts = max(TIMING.steps_a_piece, math.ceil(TIMING.least_steps / pieces))
    return _subdivided(spline.knots, np.full(pieces, parts))


def _subdivided(points: np.ndarray, parts: np.ndarray) -> np.ndarray:
    """The points, and between each and the next as many equal steps as `parts` says, shape (sum of parts + 1,)."""
    which = np.repeat(np.arange(len(parts)), parts)
    within = np.arange(len(which)) - np.repeat(np.cumsum(parts) - parts, parts)
    return np.append(points[which] + within * (np.diff(points) / parts)[which], points[-1])


def _divided(grid: np.ndarray, draft: _Motion, limits: _Limits) -> np.ndarray:
    """A better grid, given a motion on it: finer where accelerations change fast, no steps of next to no time."""
    at_start, at_end = piece_accelerations(draft.times, draft.positions, draft.velocities)
    change = (np.abs(at_end - at_start) / limits.acceleration).max(axis=1)
    dt = np.diff(draft.times)
    shortest = min(TIMING.shortest_step, TIMING.shortest_share * draft.times[-1])
    most = np.clip(dt // shortest, 1, TIMING.most_parts)
    parts = np.clip(np.ceil(change / TIMING.acceleration_change), 1, most).astype(int)
    if dt.min() >= shortest:
        return _subdivided(grid, parts)
    kept = _apart(draft.times, shortest)
    return _subdivided(grid[kept], np.maximum.reduceat(parts, kept[:-1]))


def _apart(times: np.ndarray, shortest: float) -> list[int]:
    """Indices of the first, the last and at least one inner time, otherwise of times at least `shortest` apart."""
    last = len(times) - 1
    kept = [0]
    for i in range(1, last):
        if times[i] - times[kept[-1]] >= shortest:
            kept.append(i)
    if len(kept) == 1:
        kept.append(last // 2)
    if len(kept) > 2 and times[last] - times[kept[-1]] < shortest:
        kept.pop()
    return [*kept, last]


def _squared_speeds(path: _Path, limits: _Limits) -> np.ndarray:
    """The largest squared speed (dr/dt)² at every grid point, shape (g,)."""
    nv = path.first.shape[1]
    over_steps = np.broadcast_to(limits.velocity, (len(path.steps), nv))
    at_points = np.concatenate([over_steps[:1], np.minimum(over_steps[:-1], over_steps[1:]), over_steps[-1:]])
    # where the path all but stands still in r no speed is too large for the velocities; the accelerations decide
    slowness = np.maximum((np.abs(path.first) / at_points).max(axis=1), 1e-30)
    accelerations = np.ascontiguousarray(np.broadcast_to(limits.acceleration, (len(path.steps), nv)))
    controllable, x = np.empty(len(slowness)), np.empty(len(slowness))
    path_parameterization.fastest_speeds(
        path.first, path.second, path.steps, slowness**-2.0, accelerations, controllable, x
    )
    return x


def _optimal(path: _Path, limits: _Limits) -> _Motion:
    """The motion that will be the shortest once stretched, of those under limits tightened a little each round."""
    best = motion = _timed(path, limits, limits)
    tightened = limits
    for _ in range(TIMING.most_rounds):
        if motion.load <= TIMING.small_excess:
            break
        tightened = _Limits(
            tightened.velocity / np.maximum(motion.speed_loads, 1.0),
            tightened.acceleration / np.maximum(motion.acceleration_loads, 1.0),
        )
        motion = _timed(path, tightened, limits)
        best = min(best, motion, key=lambda m: m.stretched_duration)
    return best


def _timed(path: _Path, tightened: _Limits, limits: _Limits) -> _Motion:
    """The motion that is optimal under `tightened` limits, and what it makes of the true ones."""
    speed = np.sqrt(_squared_speeds(path, tightened))
    with np.errstate(divide="ignore"):  # where a curve all but stands, one of the drafts may: the other is taken
        dt = 2.0 * path.steps / (speed[:-1] + speed[1:])  # d²r/dt² is constant over a step
    return _judged(np.concatenate([[0.0], np.cumsum(dt)]), path.positions, path.first * speed[:, None], limits)


def _judged(times: np.ndarray, positions: ChartPoints, velocities: ChartRates, limits: _Limits) -> _Motion:
    speeds, accelerations = np.empty_like(velocities[1:]), np.empty_like(velocities[1:])
    hermite.piece_peaks(times, positions, velocities, speeds, accelerations)
    return _Motion(times, positions, velocities, speeds / limits.velocity, accelerations / limits.acceleration)


def _within(motion: _Motion, spline: CubicSpline, limits: _Limits) -> _Motion:
    """The motion with velocities that keep it within the spline's position limits."""
    times, positions, velocities = motion.times, motion.positions, motion.velocities
    changed = leaving(times, positions, velocities, spline.lower, spline.upper)
    if not changed.any():
        return motion
    velocities = velocities.copy()
    velocities[:, changed] = bounded_slopes(
        times, positions[:, changed], velocities[:, changed], spline.lower[changed], spline.upper[changed]
    )
    return _judged(times, positions, velocities, limits)


def _stretched(motion: _Motion, limits: _Limits) -> Trajectory:
    """The motion, slowed down as a whole until it exceeds no limit; this does not change the curve."""
    stretch, margin = 1.0, 1e-12
    while motion.load > 1.0:
        # rounding of times and velocities can leave a trace of excess: judge again, with more margin each time
        factor = motion.load * (1.0 + margin)
        margin *= 4.0
        stretch *= factor
        motion = _judged(motion.times * factor, motion.positions, motion.velocities / factor, limits)
    # adding 0 turns the -0 of a joint that moves backwards from rest into 0
    return Trajectory(motion.times, motion.positions, motion.velocities + 0.0, stretch)
