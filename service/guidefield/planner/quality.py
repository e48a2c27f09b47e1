"""How good a motion is: its distance from everything along the way, its length and its smoothness."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from guidefield.collision.minimum.curve import Curve
from guidefield.collision.minimum.places import Places, Surveyor
from guidefield.collision.minimum.smallest import TOLERANCE, Question, Smallest, smallest
from guidefield.planner.judgement import GivenProblem
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.task.conditions import Conditions
from guidefield.planner.task.problem import Problem
from guidefield.read_only import ReadOnly
from guidefield.robot.group.kinematics import Kinematics
from guidefield.robot.model.spaces import Configurations

LENGTH_STEPS = 400
"""Chords by which the length of a way is measured, at least."""
SPACING = 0.05
"""Joint distance between samples of the clearance [rad or m]."""
MOST_SAMPLES = 100
FEWER = 3
"""The mean is over every so manieth sample; the smallest distances are looked for from there."""
SAMPLES_A_SECOND = 10.0
"""Among obstacles that move there are at least so many samples [Hz], within the most."""
END_STRETCH = 0.3
"""Joint distance at each end that the inner clearance leaves out [rad or m]."""
FINER = 100
"""Times between two close ones at which it is looked when exactly a distance has been travelled."""
MOST_FINE = 100_000
"""Times at which it is looked how far has been travelled, at most."""
LAST_MEASUREMENT = 0.5
"""For how long the smallest distances may still be looked for when time is up or the run is ended [s]."""


class MotionInTime(Protocol):
    """A motion that can be measured: a plan's trajectory, or one that was given."""

    @property
    def times(self) -> np.ndarray:
        """Of the knots, shape (n,), increasing [s]."""

    @property
    def duration(self) -> float:
        """[s]."""

    def bezier(self) -> np.ndarray:
        """Control points of the pieces, shape (m, k, nv) [rad or m]."""

    def piece_times(self) -> np.ndarray:
        """When the pieces begin, and the last one ends, shape (m + 1,) [s]."""

    def evaluate(self, times: np.ndarray, /) -> tuple[np.ndarray, ...]:
        """Chart points, shape (k, nv), first of all, at times (k,) [s]."""


@dataclass(frozen=True)
class Closest:
    """The smallest distance of some pairs along a motion.

    Attributes:
        distance: The smallest that was found, attained at `time` [m]; infinite without such a pair.
        bound: What is kept all along, certified [m]: `TOLERANCE` less, or smaller where there was no time to tell.
        time: When [s].
        pair: Names of the two bodies, a link first; None without such a pair.
    """

    distance: float
    bound: float
    time: float
    pair: tuple[str, str] | None

    @property
    def exact(self) -> bool:
        """Whether no distance is smaller by more than the tolerance."""
        return self.pair is None or self.distance - self.bound <= 1.01 * TOLERANCE


@dataclass(frozen=True, eq=False)
class Clearance(ReadOnly):
    """How far a motion keeps from everything: exact over its whole length, and samples along it.

    Attributes:
        obstacle: Of the moving links from obstacles, as they stand at the time.
        inner: The same less `END_STRETCH` of the way at each end; None if nothing is left.
        own: Of the robot from itself.
        times: Of samples, shape (k,) [s]: evenly by joint distance, by time among obstacles that move.
        lengths: Joint distance travelled at them, shape (k,) [rad or m].
        mean: Mean distance from obstacles over every third sample [m].
        ends: The smaller of the distances from obstacles at start and goal [m].
        surveyor: What measured.
        places: The robot at some times, among them every third sample's.
    """

    obstacle: Closest
    inner: Closest | None
    own: Closest
    times: np.ndarray
    lengths: np.ndarray
    mean: float
    ends: float
    surveyor: Surveyor
    places: Places


@dataclass(frozen=True, eq=False)
class ClearanceProfile(ReadOnly):
    """Distances along a motion, exact at its samples.

    Attributes:
        times: Shape (n,) [s]; those at which distances are smallest are among them.
        configurations: Of the group, shape (n, nq).
        lengths: Joint distance travelled, shape (n,) [rad or m].
        obstacle_distance: From moving links to obstacles, shape (n,) [m]; infinite without obstacles.
        obstacle_pair: Names of the closest pair (link, obstacle), or None.
        witness: The closest points, shape (n, 2, 3) [m, world].
        self_distance: From the robot to itself, shape (n,) [m]; infinite without pairs.
        self_pair: Names of the closest links, or None.
        potentials: Evaluates the potential U at the samples, shape (n,) [m].
    """

    times: np.ndarray
    configurations: Configurations
    lengths: np.ndarray
    obstacle_distance: np.ndarray
    obstacle_pair: tuple[tuple[str, str] | None, ...]
    witness: np.ndarray
    self_distance: np.ndarray
    self_pair: tuple[tuple[str, str] | None, ...]
    potentials: Callable[[], np.ndarray]

    @cached_property
    def potential(self) -> np.ndarray:
        """U along the motion, shape (n,) [m]: found when it is asked for, since only recordings hold it."""
        return self.potentials()


@dataclass(frozen=True)
class Figures:
    """Length, duration and smoothness of a motion.

    Attributes:
        joint_path_length: Length in the chart [rad or m].
        tip_path_length: Length of the tip's way [m].
        duration: [s].
        peak_jerk: Largest jerk within a piece of the trajectory [rad/s^3 or m/s^3].
        smoothness: Bending energy of the way in the chart times its length, dimensionless; 0 for a straight motion.
    """

    joint_path_length: float
    tip_path_length: float
    duration: float
    peak_jerk: float
    smoothness: float


def clearance(trajectory: MotionInTime, problem: Conditions) -> Clearance:
    """Measure a trajectory, among the obstacles as they stand meanwhile.

    The smallest distances are looked for until time is up, and at least for `LAST_MEASUREMENT`: see `Closest.exact`.
    """
    until = time.monotonic() + LAST_MEASUREMENT

    def stopped() -> object:
        return time.monotonic() >= until and problem.budget.spent()

    surveyor = Surveyor(problem.timed_world, Curve(trajectory.bezier(), trajectory.piece_times()))
    times, lengths, inside = _samples(trajectory, problem)
    coarse, start, end = np.unique(np.r_[times[::FEWER], times[-1]]), float(times[0]), float(times[-1])
    breaks = surveyor.breaks[(surveyor.breaks > start) & (surveyor.breaks < end)]
    places = surveyor.places(np.unique(np.concatenate([coarse, breaks, inside or ()])))
    world, rows = problem.world, np.searchsorted(places.times, coarse)
    mixed = np.flatnonzero(world.is_obstacle_pair)
    sampled = np.full(len(rows), np.inf)
    if len(mixed):
        sampled = places.distances[rows, surveyor.closest(places, rows, mixed)]
    spans = [(start, end), *([inside] if inside else [])]
    questions = [Question(world.is_obstacle_pair, *span) for span in spans]
    obstacle, *inner = smallest(surveyor, places, questions, stopped=stopped)
    few = np.flatnonzero(np.isin(places.times, np.concatenate([coarse[::2], breaks, [end]])))
    fewer = places.rows(few)
    (own,) = smallest(surveyor, fewer, [Question(~world.is_obstacle_pair, start, end)], stopped=stopped)
    places.distances[few], places.stages[few] = fewer.distances, fewer.stages
    return Clearance(
        obstacle=_closest(obstacle, problem),
        inner=_closest(inner[0], problem) if inner else None,
        own=_closest(own, problem),
        times=times,
        lengths=lengths,
        mean=float(sampled.mean()),
        ends=float(min(sampled[0], sampled[-1])),
        surveyor=surveyor,
        places=places,
    )


def clearance_profile(measured: Clearance, problem: Problem | GivenProblem) -> ClearanceProfile:
    """Distances and potential at the samples of a trajectory that was measured, for its recording."""
    group, surveyor = problem.group, measured.surveyor
    smallest_at = [one.time for one in (measured.obstacle, measured.inner, measured.own) if one and one.pair]
    times = np.unique(np.concatenate([measured.times, smallest_at]))
    known = np.isin(times, measured.places.times)
    places = measured.places.with_more(surveyor.places(times[~known]))
    order = np.argsort(places.times, kind="stable")
    rows = order[np.searchsorted(places.times[order], times)]
    configurations = np.array([group.from_chart(z) for z in surveyor.curve.at(times)[0]])
    mixed, witness = problem.world.is_obstacle_pair, np.full((len(times), 2, 3), np.nan)
    obstacle_distance, obstacle_pair = _at_rows(surveyor, places, rows, np.flatnonzero(mixed))
    self_distance, self_pair = _at_rows(surveyor, places, rows, np.flatnonzero(~mixed))
    for index, (instant, pair) in enumerate(zip(times.tolist(), obstacle_pair, strict=True)):
        if pair is not None:
            witness[index] = surveyor.witness(instant, pair)
    return ClearanceProfile(
        times=times,
        configurations=configurations,
        lengths=np.interp(times, measured.times, measured.lengths),
        obstacle_distance=obstacle_distance,
        obstacle_pair=tuple(None if pair is None else problem.world.pair_names(pair) for pair in obstacle_pair),
        witness=witness,
        self_distance=self_distance,
        self_pair=tuple(None if pair is None else problem.world.pair_names(pair) for pair in self_pair),
        potentials=lambda: np.array(
            [problem.potential(t, q) for t, q in zip(times.tolist(), configurations, strict=True)]
        ),
    )


def _closest(found: Smallest, problem: Conditions) -> Closest:
    """An answer in the words of the scene."""
    pair = None if found.pair < 0 else problem.world.pair_names(found.pair)
    return Closest(found.distance, found.bound, found.time, pair)


def _at_rows(
    surveyor: Surveyor, places: Places, rows: np.ndarray, pairs: np.ndarray
) -> tuple[np.ndarray, list[int] | list[None]]:
    """The smallest distance (k,) of some pairs at rows (k,) of places, and of which pair it is."""
    if not len(pairs):
        return np.full(len(rows), np.inf), [None] * len(rows)
    nearest = surveyor.closest(places, rows, pairs)
    return places.distances[rows, nearest], nearest.tolist()


def figures(trajectory: Trajectory, kinematics: Kinematics) -> Figures:
    """Length, duration and smoothness of a trajectory."""
    samples = trajectory.evaluate(_within_pieces(trajectory))[0]
    tips = np.array([kinematics.tip_position(kinematics.group.expand_from_chart(z)) for z in samples])
    return Figures(
        joint_path_length=_length(samples),
        tip_path_length=_length(tips),
        duration=trajectory.duration,
        peak_jerk=trajectory.peak_jerk,
        smoothness=_bending(trajectory),
    )


def _within_pieces(trajectory: Trajectory) -> np.ndarray:
    """Times from knot to knot, evenly by an even number of steps, 4 at least and `LENGTH_STEPS` in all."""
    knots = trajectory.times
    steps = 2 * math.ceil(max(2.0, 0.5 * LENGTH_STEPS / max(1, len(knots) - 1)))
    shares = np.arange(steps) / steps
    times: np.ndarray = np.append((knots[:-1, None] + np.diff(knots)[:, None] * shares).ravel(), knots[-1])
    return times


def _length(points: np.ndarray) -> float:
    """Length of a smooth way through an odd number of points (n, k), Richardson's extrapolation of its chords."""
    fine, coarse = (float(np.linalg.norm(np.diff(some, axis=0), axis=1).sum()) for some in (points, points[::2]))
    return (4.0 * fine - coarse) / 3.0


def _samples(
    trajectory: MotionInTime, problem: Conditions
) -> tuple[np.ndarray, np.ndarray, tuple[float, float] | None]:
    """Times of samples, the distances travelled by then, and between which times the inner way is, if there is one."""
    fine, travelled = _travelled(trajectory)
    inside = None
    if travelled[-1] > 2.0 * END_STRETCH:
        ends = (END_STRETCH, float(travelled[-1]) - END_STRETCH)
        since, until = (_when(trajectory, fine, travelled, length) for length in ends)
        inside = (since, until)
    times = np.interp(_even_lengths(travelled), travelled, fine)
    if problem.scene.moves or travelled[-1] <= 0.0:
        count = max(len(times), int(np.ceil(trajectory.duration * SAMPLES_A_SECOND)) + 1)
        times = np.linspace(fine[0], fine[-1], min(count, MOST_SAMPLES))
    times[[0, -1]] = fine[[0, -1]]
    times = np.unique(times)
    return times, np.interp(times, fine, travelled), inside


def _even_lengths(travelled: np.ndarray) -> np.ndarray:
    """Equal joint distances up to the last of some that were travelled (n,), shape (k,)."""
    count = int(np.clip(np.ceil(travelled[-1] / SPACING) + 1, 2, MOST_SAMPLES))
    return np.linspace(0.0, travelled[-1], count)


def _when(trajectory: MotionInTime, fine: np.ndarray, travelled: np.ndarray, length: float) -> float:
    """When a trajectory has travelled a joint distance [s], from many times (n,) and the distances by then (n,)."""
    first = int(np.clip(np.searchsorted(travelled, length) - 1, 0, len(fine) - 2))
    finer = np.linspace(fine[first], fine[first + 1], FINER)
    return float(np.interp(length, travelled[first] + _lengths(trajectory, finer), finer))


def _travelled(trajectory: MotionInTime) -> tuple[np.ndarray, np.ndarray]:
    """Many times along a trajectory, and the joint distances that it has travelled by then."""
    many = min(20 * len(trajectory.times) + 2, MOST_FINE)
    fine = np.linspace(trajectory.times[0], trajectory.times[-1], many)
    return fine, _lengths(trajectory, fine)


def _lengths(trajectory: MotionInTime, times: np.ndarray) -> np.ndarray:
    """Joint distances travelled since the first of some times (n,), shape (n,) [rad or m]."""
    steps = np.linalg.norm(np.diff(trajectory.evaluate(times)[0], axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _bending(trajectory: Trajectory) -> float:
    """Integral of the squared curvature by length, times the length."""
    fine, travelled = _travelled(trajectory)
    lengths = _even_lengths(travelled)
    times = np.interp(lengths, travelled, fine)
    if lengths[-1] <= 0.0 or len(times) < 3:
        return 0.0
    points = trajectory.evaluate(times)[0]
    directions = np.diff(points, axis=0)
    norms = np.linalg.norm(directions, axis=1)
    cosines = np.einsum("ij,ij->i", directions[1:], directions[:-1]) / np.maximum(norms[1:] * norms[:-1], 1e-30)
    turns = np.arccos(np.clip(cosines, -1.0, 1.0))
    return float((turns**2).sum() / lengths[1] * lengths[-1])
