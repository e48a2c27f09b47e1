"""Comparison of motions among obstacles that move, splines or not: by arrival, and by the distance that they keep."""

from __future__ import annotations

import math

import numpy as np

from guidefield.kernels.barrier.moving_barrier import moving_distance
from guidefield.kernels.barrier.obstacle_barrier import nothing_remembered, obstacle_distance
from guidefield.kernels.barrier.sampled_robot import SampledRobot
from guidefield.kernels.optimize.clearance_model import clearance_along
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.optimize.clearance_samples import samples_in_time
from guidefield.planner.optimize.sampled_robot import sampled_robot
from guidefield.planner.optimize.settings import SAMPLED_ROBOT, OptimizationSettings
from guidefield.planner.task.problem import Problem
from guidefield.robot.model.spaces import ChartPoint
from guidefield.scene.distance_tables import distance_tables, moving_tables


def better(problem: Problem, motion: Trajectory, other: Trajectory, settings: OptimizationSettings) -> bool:
    """Whether a motion has a lower objective than another one of the same ends: arrival and clearance as optimised."""
    tables, moving, ends = distance_tables(problem.scene), moving_tables(problem.scene), other.positions[[0, -1]]
    robot = sampled_robot(problem, tables, ends)
    kept = [kept_at(problem, robot, z, time) for z, time in zip(ends, other.times[[0, -1]].tolist(), strict=True)]
    values = []
    for one in (motion, other):
        samples, points = samples_in_time(
            one, (kept[0], kept[1]), problem.min_clearance, settings.compared, settings, problem.group.sizes
        )
        n, nv = points.shape
        clearance, _ = clearance_along(
            robot,
            tables,
            moving,
            samples,
            points,
            1.0,
            0.0,
            problem.min_clearance,
            math.inf,
            nothing_remembered(settings.compared, len(robot.groups)),
            np.empty((n, nv)),
            np.empty(settings.compared, np.int64),
            np.empty((settings.compared, 4)),
            np.empty((settings.compared, nv, nv)),
            np.empty((2, n, nv)),
            np.empty(2),
            np.empty((2, 2)),
        )
        values.append(float(one.times[-1]) / other.duration + clearance)
    return values[0] < values[1]


def keeps_aside(problem: Problem, motion: Trajectory, distance: float) -> bool:
    """Return whether the robot's points keep a distance [m] from all that moves, at samples of a motion.

    Where they don't no certificate says that the robot keeps it; where they do it has to be asked.
    """
    tables, moving = distance_tables(problem.scene), moving_tables(problem.scene)
    robot = sampled_robot(problem, tables, motion.positions[:0])
    count = math.ceil(motion.duration / SAMPLED_ROBOT.spacing) + 1
    times = np.linspace(float(motion.times[0]), float(motion.times[-1]), count)
    places = zip(motion.evaluate(times)[0], times.tolist(), strict=True)
    return all(moving_distance(robot, moving, z, time, distance) >= distance for z, time in places)


def kept_at(problem: Problem, robot: SampledRobot, z: ChartPoint, time: float) -> float:
    """What a robot keeps from obstacles at a chart point (nv,) and a time [s], at most `farthest` at its size [m]."""
    z, most = np.ascontiguousarray(z), SAMPLED_ROBOT.farthest * problem.group.size
    at_rest = obstacle_distance(robot, distance_tables(problem.scene), z, most)
    if not problem.scene.moves:
        return at_rest
    return min(at_rest, moving_distance(robot, moving_tables(problem.scene), z, time, most))
