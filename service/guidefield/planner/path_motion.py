"""Motions along a path, as fast as the limits allow: round its corners, or with a stop at each of them."""

from __future__ import annotations

from itertools import pairwise
from typing import cast

import numpy as np

from guidefield.planner.connect.constrained_tree import Keeper
from guidefield.planner.motion.bspline import BSpline
from guidefield.planner.motion.settings import CURVE
from guidefield.planner.motion.timing import Limits, PathCurve, executed, parameterize
from guidefield.planner.motion.trajectory import Trajectory, one_after_another
from guidefield.planner.motion.waypoints import distinct, subdivided
from guidefield.planner.task.problem import Problem
from guidefield.robot.model.spaces import ChartPoint, ChartPoints, ChartRate, ChartRates


def limits_of(problem: Problem) -> Limits:
    """The limits of rates that a problem's motions keep."""
    group = problem.group
    jerk = problem.jerk_limits
    unlimited = cast(ChartRate, np.full(group.nv, np.inf))
    return Limits(group.velocity_limits, group.acceleration_limits, unlimited if jerk is None else jerk)


def rounded_spline(problem: Problem, path: ChartPoints, limits: Limits, finer: int = 1) -> BSpline:
    """The fastest motion round the corners of a path (n, nv), from rest to rest.

    Args:
        finer: Control points of the curve, and pieces of the motion, are so many times as dense.
    """
    places = subdivided(distinct(path), CURVE.spacing / finer, problem.group.sizes)
    if problem.path_constraints:
        keeper = Keeper(problem, problem.constrained_frames)
        back = [z if (kept := keeper.brought_back(z)) is None else kept for z in places[1:-1]]
        places = distinct(cast(ChartPoints, np.array([places[0], *back, places[-1]])))
    return parameterize(PathCurve.along(places), limits, finer)


def motion_along(problem: Problem, path: ChartPoints, finer: int = 1) -> Trajectory:
    """The same within the problem's limits; a single knot where the path (n, nv) goes nowhere."""
    return _within(problem, path, limits_of(problem), finer)


def soonest_along(problem: Problem, path: ChartPoints) -> Trajectory:
    """The same along a path (n, nv), whatever its jerk."""
    unlimited = cast(ChartRate, np.full(problem.group.nv, np.inf))
    return _within(problem, path, limits_of(problem)._replace(jerk=unlimited))


def _within(problem: Problem, path: ChartPoints, limits: Limits, finer: int = 1) -> Trajectory:
    if len(distinct(path)) == 1:
        return standing(path[0])
    return executed(rounded_spline(problem, path, limits, finer), limits)


def stopping_along(problem: Problem, path: ChartPoints) -> tuple[Trajectory, list[int]]:
    """The motion along the very path (n, nv), at rest at every waypoint; and its knot at each of them."""
    limits = limits_of(problem)
    parts = []
    for begin, end in pairwise(path):
        line = cast(ChartPoints, np.array([begin, end]))
        if len(distinct(line)) == 1:
            parts.append(standing(begin))
        else:
            places = subdivided(line, CURVE.spacing, problem.group.sizes)
            parts.append(executed(parameterize(PathCurve.along(places), limits), limits))
    knots = np.r_[0, np.cumsum([len(part.times) - 1 for part in parts])]
    return one_after_another(parts), knots.tolist()


def standing(z: ChartPoint) -> Trajectory:
    """The motion that stays at a chart point (nv,)."""
    return Trajectory(np.zeros(1), cast(ChartPoints, z[None].copy()), cast(ChartRates, np.zeros((1, len(z)))))
