"""The motion found so far, and motions along a path as fast as the limits allow.

Motions keep limits of rates whatever the constants are (`motion/timing.py`); these change how far they are from the
path, how long they take and how often the certificate refuses them. service/docs/algorithm.md repeats `CURVE_SPACING`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Self, cast

import numpy as np

from guidefield.planner.connect import Keeper
from guidefield.planner.motion.bspline import BSpline
from guidefield.planner.motion.timing import (
    REPEATED,
    Limits,
    PathCurve,
    lengths_of,
    parameterize,
    remove_repetitions,
    stretch_spline_to_limits,
    subdivide,
)
from guidefield.planner.motion.trajectory import Trajectory, concatenate
from guidefield.planner.task.motion_limits import MotionLimit
from guidefield.planner.task.problem import Problem
from guidefield.planner.task.stages import Ending
from guidefield.prove.curve import polyline
from guidefield.read_only import ReadOnly
from guidefield.robot.model.joints import LocalCurves, LocalPoint, LocalPoints, LocalRate, LocalRates

# largest spacing of control points of the curve along a path [rad or m]. On 100 public problems of four robots, nothing
# optimised: with 0.18 motions take 1 to 4 % longer; with 0.5 they take 1 to 4 % less, and one in six more is refused at
# first, whose certificates take longer
CURVE_SPACING = 0.3

RETIMED_SAMPLES = 513  # samples by which lengths along a motion are measured that is timed anew
RETIMED_PLACES = 129  # places on its path, evenly by length
RETIMED_FINER = 2  # times as many pieces as along a path


def limits_of(problem: Problem) -> Limits:
    """The limits of rates that a problem's motions keep."""
    group = problem.group
    jerk = problem.jerk_limits
    unlimited = cast(LocalRate, np.full(group.nv, np.inf))
    own = unlimited if jerk is None else jerk
    return Limits(group.velocity_limits, group.acceleration_limits, own, problem.motion_limits, problem.deadline)


def round_path(problem: Problem, path: LocalPoints, limits: Limits, finer: int = 1) -> BSpline:
    """The fastest motion round the corners of a path (n, nv), from rest to rest.

    Args:
        finer: Control points of the curve, and pieces of the motion, are that many times as dense.
    """
    places = subdivide(remove_repetitions(path), CURVE_SPACING / finer, problem.group.sizes)
    if problem.path_constraints:
        keeper = Keeper(problem, problem.constrained_frames)
        back = [z if (kept := keeper.bring_back(z)) is None else kept for z in places[1:-1]]
        places = remove_repetitions(cast(LocalPoints, np.array([places[0], *back, places[-1]])))
    return parameterize(PathCurve.along(places, problem.group.sizes), limits, finer)


def time_path(problem: Problem, path: LocalPoints, finer: int = 1) -> Trajectory:
    """As `round_path`, within the problem's limits; a single knot where the path (n, nv) goes nowhere."""
    return _time_within(problem, path, limits_of(problem), finer)


def time_path_ignoring_jerk(
    problem: Problem, path: LocalPoints, motion_limits: tuple[MotionLimit, ...] = ()
) -> Trajectory:
    """As `time_path`, whatever its jerk; within the given limits of the whole instead of the problem's."""
    unlimited = cast(LocalRate, np.full(problem.group.nv, np.inf))
    return _time_within(problem, path, limits_of(problem)._replace(jerk=unlimited, motion_limits=motion_limits))


def _time_within(problem: Problem, path: LocalPoints, limits: Limits, finer: int = 1) -> Trajectory:
    if len(remove_repetitions(path)) == 1:
        return make_standing_motion(path[0])
    return stretch_spline_to_limits(round_path(problem, path, limits, finer), limits)


def retime_motion(problem: Problem, motion: Trajectory) -> BSpline | None:
    """The fastest motion along the path of another one from rest to rest; None where that goes nowhere.

    It leaves the path a little where that bends, the less the shorter its pieces are: see `timing`.
    """
    times = np.linspace(motion.times[0], motion.times[-1], RETIMED_SAMPLES)
    points = cast(LocalPoints, motion.evaluate(times)[0] / problem.group.sizes)
    lengths = np.concatenate([[0.0], np.cumsum(lengths_of(points))])
    if lengths[-1] <= REPEATED:
        return None
    evenly = np.interp(np.linspace(0.0, lengths[-1], RETIMED_PLACES), lengths, times)
    places = remove_repetitions(motion.evaluate(evenly)[0])
    return parameterize(PathCurve.along(places, problem.group.sizes), limits_of(problem), RETIMED_FINER)


def time_path_with_stops(problem: Problem, path: LocalPoints) -> tuple[Trajectory, list[int]]:
    """The motion along the very path (n, nv), at rest at every waypoint; and its knot at each of them."""
    limits = limits_of(problem)
    parts = []
    for begin, end in pairwise(path):
        line = cast(LocalPoints, np.array([begin, end]))
        if len(remove_repetitions(line)) == 1:
            parts.append(make_standing_motion(begin))
        else:
            sizes = problem.group.sizes
            curve = PathCurve.along(subdivide(line, CURVE_SPACING, sizes), sizes)
            parts.append(stretch_spline_to_limits(parameterize(curve, limits), limits))
    knots = np.r_[0, np.cumsum([len(part.times) - 1 for part in parts])]
    return concatenate(parts), knots.tolist()


def make_standing_motion(z: LocalPoint) -> Trajectory:
    """The motion that stays at local coordinates (nv,)."""
    return Trajectory(np.zeros(1), cast(LocalPoints, z[None].copy()), cast(LocalRates, np.zeros((1, len(z)))))


@dataclass(frozen=True, eq=False)
class PathSoFar(ReadOnly):
    """The motion found so far, and why it goes no further where a stage failed."""

    path: LocalPoints
    # by index of each guide plane that was reached, its index in `path`
    crossings: Mapping[int, int] = field(default_factory=dict)
    proven: bool = True  # whether its straight pieces are certified, not only free at samples
    # other paths from the same start to a goal, shape (n, nv) each, free at samples: they may prove quicker
    others: tuple[LocalPoints, ...] = ()
    failure: Ending | None = None  # why the stage after it found nothing; None while none failed

    @classmethod
    def at_start(cls, problem: Problem) -> PathSoFar:
        """Nothing but a problem's start."""
        return cls(problem.z_start[None])

    def extend(self, points: LocalPoints, *, proven: bool = True, others: tuple[LocalPoints, ...] = ()) -> PathSoFar:
        """Gone on from where the path ends, along points (n, nv) that begin there, and along other paths (n, nv)."""
        path, *rest = (np.concatenate([self.path, onward[1:]]) for onward in (points, *others))
        return dataclasses.replace(self, path=path, proven=self.proven and proven, others=tuple(rest))

    def with_plane_reached(self, index: int) -> Self:
        """The same, with the guide plane of an index reached where the path ends."""
        return dataclasses.replace(self, crossings={**self.crossings, index: len(self.path) - 1})

    def back_at_start(self) -> PathSoFar:
        """Nothing but the first point."""
        return PathSoFar(self.path[:1])

    def with_failure(self, failure: Ending) -> Self:
        """The same, as far as it goes."""
        return dataclasses.replace(self, failure=failure)

    def bezier(self) -> LocalCurves:
        """Control points of its pieces, shape (m, k, nv), m >= 1 [rad or m]."""
        return polyline(self.path)

    def piece_times(self) -> np.ndarray:
        """Times at which the pieces begin, and the last one ends, (m + 1,) [s]; numbers, as they have no times."""
        return np.arange(float(len(self.path))) if len(self.path) > 1 else np.zeros(2)
