"""Scale a motion's time until it reaches a limit and exceeds none; measure the share of each limit that one uses.

That plans keep limits of rates rests on `stretch_to_limits`, and on enough `MOST_ROUNDS`: with few of them rounding may
leave an excess. `STEP` and `ROUNDING` enter the verdict on given and drawn motions, `TOLERANCE` what is refused at ends
in motion, taken there and as schedules: less than `KEPT_SHARE` - 1 (task/motion_limits.py), which judges motions.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from guidefield.deadline import UNLIMITED, Deadline
from guidefield.kernels.timing import hermite
from guidefield.planner.motion.submitted_motion import CurveKind, QuinticMotion, SubmittedMotion
from guidefield.planner.motion.trajectory import Trajectory, piece_accelerations
from guidefield.planner.task.motion_limits import KEPT_SHARE, MotionLimit
from guidefield.prove.curve import largest_magnitudes
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.model.joints import LocalPoints, LocalRate, LocalRates

TOLERANCE = 1e-9  # by this share a motion may exceed a limit, for rounding
MOST_ROUNDS = 16  # rounds of stretching at most: more than one is needed for rounding, and for limits of the whole


def measure_limit_load(
    times: np.ndarray,
    positions: LocalPoints,
    velocities: LocalRates,
    velocity_limits: LocalRate,
    acceleration_limits: LocalRate,
    jerk_limits: LocalRate,
) -> float:
    """The factor by which time has to be stretched to exceed no limit, and to reach one.

    Of knots: times (n,), n >= 2, positions and velocities (n, nv); limits (nv,), that of jerk infinite where there is
    none. The extrema of a Hermite piece are known exactly; its jerk is constant.
    """
    shares = np.empty(3)
    hermite.largest_shares(times, positions, velocities, velocity_limits, acceleration_limits, jerk_limits, shares)
    velocity, acceleration, jerk = shares.tolist()
    return max(velocity, math.sqrt(acceleration), math.cbrt(jerk))


def stretch_to_limits(
    times: np.ndarray,
    positions: LocalPoints,
    velocities: LocalRates,
    velocity_limits: LocalRate,
    acceleration_limits: LocalRate,
    jerk_limits: LocalRate,
    motion_limits: Sequence[MotionLimit] = (),
    deadline: Deadline = UNLIMITED,
) -> Trajectory:
    """A motion, given as for `measure_limit_load`, with time scaled so that it reaches a limit and exceeds none.

    A limit of the whole motion that no time is long enough for is left exceeded, and so may any be when time is up.
    """
    stretch, margin = 1.0, 1e-12
    for _ in range(MOST_ROUNDS):
        load = measure_limit_load(
            times * stretch, positions, velocities / stretch, velocity_limits, acceleration_limits, jerk_limits
        )
        if stretch != 1.0 and load <= 1.0:
            break
        # rounding can leave a trace of excess: judge again, with more margin each time
        stretch *= load * (1.0 + margin)
        margin *= 4.0
    for _ in range(MOST_ROUNDS if motion_limits else 0):
        motion = Trajectory(times * stretch, positions, velocities / stretch)
        load = max(limit.stretch(motion.polynomials) for limit in motion_limits)
        if load <= 1.0 or not math.isfinite(load) or deadline.expired():
            break
        stretch *= load * (1.0 + margin)
        margin *= 4.0
    # adding 0 turns the -0 of a joint that moves backwards from rest into 0
    return Trajectory(times * stretch, positions, velocities / stretch + 0.0, max(stretch, 1.0))


STEP = 1e-6  # an acceleration jumps at a knot where it changes by more than this share of its limit

ROUNDING = 16.0 * float(np.finfo(float).eps)
"""Rounding of positions, as a share of them, in accelerations that are their differences."""


@dataclass(frozen=True)
class LimitUse:
    """The largest share of a limit."""

    # 1 is the limit; None where nothing is limited, there is no such rate, or it has no bound
    share: float | None = None
    coordinate: int | None = None  # the local coordinate whose share it is; None where nothing is limited
    piece: int = 0  # piece of the motion, and the share of it that has passed there
    at: float = 0.0
    steps: bool = False  # whether the rate of the next lower order jumps there, so that no limit is kept

    @property
    def is_within(self) -> bool:
        """True if no limit is exceeded."""
        return not self.steps and (self.share is None or self.share <= KEPT_SHARE)


@dataclass(frozen=True)
class LimitUses:
    """The largest shares of all limits."""

    position: LimitUse = LimitUse()
    velocity: LimitUse = LimitUse()
    acceleration: LimitUse = LimitUse()
    jerk: LimitUse = LimitUse()


def measure_limit_shares(motion: SubmittedMotion, group: PlanningGroup, jerk_limits: LocalRate | None) -> LimitUses:
    """The largest shares of its limits that a motion uses; without limits of jerk (nv,), jerk doesn't matter.

    Rates are those of local coordinates, as in a plan: a planar or floating joint's are of its place in the world and
    of its angle or rotation vector.
    """
    with np.errstate(invalid="ignore"):  # infinity less infinity, where there is no limit
        middle, half = 0.5 * (group.lower + group.upper), 0.5 * (group.upper - group.lower)
    ranged = np.isfinite(half) & (half > 0.0)
    middle, half = np.where(ranged, middle, 0.0), np.where(ranged, half, np.inf)
    knots = np.abs(motion.positions - middle) / half
    if motion.times is None or motion.is_point:
        position = _largest(knots[:-1], knots[-1:], ranged)
        velocity = _at_point(motion, motion.velocities, group.velocity_limits)
        return LimitUses(position, velocity, _at_point(motion, motion.accelerations, group.acceleration_limits))
    if motion.quintic is not None:
        return _quintic_shares(motion.quintic, group, middle, half, ranged, jerk_limits)
    spans = np.diff(motion.times)[:, None]
    if motion.kind is CurveKind.LINEAR or motion.velocities is None:
        rates = np.abs(np.diff(motion.positions, axis=0) / spans) / group.velocity_limits
        return LimitUses(_largest(knots[:-1], knots[-1:], ranged), _largest(rates, rates[-1:]))
    begins, ends = piece_accelerations(motion.times, motion.positions, motion.velocities)
    jerks = (ends - begins) / spans
    start, speed = motion.positions[:-1], motion.velocities[:-1]
    inner, places = _extrema(start, speed, begins, jerks, spans)
    position = _largest(knots[:-1], knots[-1:], ranged, np.abs(inner - middle) / half, places)
    with np.errstate(divide="ignore", invalid="ignore"):
        turn = np.where(begins * ends < 0.0, -begins / jerks, 0.0)
    fastest = np.abs(speed + turn * (begins + 0.5 * turn * jerks)) / group.velocity_limits
    at_knots = np.abs(motion.velocities) / group.velocity_limits
    velocity = _largest(at_knots[:-1], at_knots[-1:], None, fastest[None], (turn / spans)[None])
    first, second = np.abs(begins) / group.acceleration_limits, np.abs(ends) / group.acceleration_limits
    acceleration = _largest(first, second[-1:], None, second[None], np.ones((1, *second.shape)))
    if jerk_limits is None:
        return LimitUses(position, velocity, acceleration)
    limited = np.isfinite(jerk_limits)
    if (step := _step(motion, begins, ends, group.acceleration_limits, limited)) is not None:
        return LimitUses(position, velocity, acceleration, step)
    shares = np.abs(jerks) / jerk_limits
    return LimitUses(position, velocity, acceleration, _largest(shares, shares[-1:], limited))


def _quintic_shares(
    motion: QuinticMotion,
    group: PlanningGroup,
    middle: np.ndarray,
    half: np.ndarray,
    ranged: np.ndarray,
    jerk_limits: LocalRate | None,
) -> LimitUses:
    velocities, accelerations, jerks = motion.rates()
    unlimited = np.ones(len(ranged), bool)
    return LimitUses(
        _largest_of((motion.bezier() - middle) / half, ranged),
        _largest_of(velocities / group.velocity_limits, unlimited),
        _largest_of(accelerations / group.acceleration_limits, unlimited),
        LimitUse() if jerk_limits is None else _largest_of(jerks / jerk_limits, np.isfinite(jerk_limits)),
    )


def _largest_of(shares: np.ndarray, counts: np.ndarray) -> LimitUse:
    """The largest share along Bezier curves of shares (m, k, nv), of the coordinates that count, (nv,)."""
    if not counts.any():
        return LimitUse()
    most, pieces, places = largest_magnitudes(shares)
    coordinate = int(np.argmax(np.where(counts, most, -1.0)))
    return LimitUse(float(most[coordinate]), coordinate, int(pieces[coordinate]), float(places[coordinate]))


def _at_point(motion: SubmittedMotion, given: LocalRates | None, limits: LocalRate) -> LimitUse:
    """The largest share of a limit that the rates given at a single knot use, shape (k, nv); none without times."""
    if motion.times is None or given is None:
        return LimitUse(0.0, 0) if motion.times is not None else LimitUse()
    shares = (np.abs(given) / limits).max(axis=0)
    return LimitUse(float(shares.max()), int(np.argmax(shares)))


def _extrema(
    start: LocalPoints, speed: LocalRates, acceleration: LocalRates, jerk: LocalRates, spans: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Positions where the velocity v + a t + j t² / 2 of pieces is 0, and the shares of the pieces: both (2, m, nv).

    Where there is none within a piece, its start stands there. The roots are -2 v / (a ± sqrt(a² - 2 j v)) and that of
    the other sign's form, so that no two equal numbers are subtracted.
    """
    root = np.sqrt(np.maximum(acceleration**2 - 2.0 * jerk * speed, 0.0))
    sum_ = -(acceleration + np.where(acceleration < 0.0, -root, root))
    with np.errstate(divide="ignore", invalid="ignore"):
        times = np.stack([sum_ / jerk, 2.0 * speed / sum_])
    times = np.where(np.isfinite(times) & (times > 0.0) & (times < spans), times, 0.0)
    return start + times * (speed + times * (0.5 * acceleration + times * jerk / 6.0)), times / spans


def _step(
    motion: SubmittedMotion, begins: LocalRates, ends: LocalRates, limits: LocalRate, limited: np.ndarray
) -> LimitUse | None:
    """The largest jump of an acceleration at a knot, as a share of its limit; None where there is none."""
    if motion.kind is CurveKind.SPLINE or len(begins) < 2:
        return None
    assert motion.times is not None, "it has accelerations"
    shortest = np.minimum(np.diff(motion.times)[:-1], np.diff(motion.times)[1:])[:, None]
    noise = ROUNDING * (1.0 + np.abs(motion.positions[1:-1])) / shortest**2
    jumps = np.where(limited, np.abs(begins[1:] - ends[:-1]) - noise, 0.0) / limits
    knot, coordinate = np.unravel_index(int(np.argmax(jumps)), jumps.shape)
    if jumps[knot, coordinate] <= STEP:
        return None
    return LimitUse(None, int(coordinate), int(knot) + 1, 0.0, steps=True)


def _largest(
    at_starts: np.ndarray,
    at_end: np.ndarray,
    counts: np.ndarray | None = None,
    inner: np.ndarray | None = None,
    places: np.ndarray | None = None,
) -> LimitUse:
    counts = np.ones(at_end.shape[1], bool) if counts is None else counts
    if not counts.any():
        return LimitUse()
    all_shares, all_places = [at_starts, np.tile(at_end, (len(at_starts), 1))], [np.zeros(at_starts.shape)]
    all_shares[1][:-1] = 0.0  # the end of the last piece alone
    all_places.append(np.ones(at_starts.shape))
    if not len(at_starts):  # a point
        all_shares, all_places = [at_end], [np.zeros(at_end.shape)]
    if inner is not None and places is not None:
        all_shares += list(inner)
        all_places += list(places)
    shares = np.where(counts, np.stack(all_shares), -1.0)
    which, piece, coordinate = np.unravel_index(int(np.argmax(shares)), shares.shape)
    return LimitUse(
        float(shares[which, piece, coordinate]),
        int(coordinate),
        int(piece),
        float(np.stack(all_places)[which, piece, coordinate]),
    )
