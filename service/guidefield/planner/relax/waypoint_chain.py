"""A chain of waypoints under relaxation: its objective, the damped Newton step, and where a step may lead."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from guidefield.kernels.distance.distance import DistanceTables
from guidefield.kernels.linalg.block_tridiagonal import solve_free
from guidefield.kernels.relax.obstacle_barrier import obstacle_distance
from guidefield.kernels.relax.relaxation import PathSamples, objective
from guidefield.kernels.relax.sampled_robot import SampledRobot
from guidefield.kernels.relax.verlet_list import NearBodies, nothing_remembered
from guidefield.planner.motion.waypoints import length_of
from guidefield.planner.relax.path_samples import path_samples
from guidefield.planner.relax.plane_crossing import PlaneCrossing
from guidefield.planner.relax.settings import BARRIER, RELAXATION
from guidefield.planner.task.problem import Problem
from guidefield.read_only import ReadOnly
from guidefield.robot.model.margin import MARGIN
from guidefield.robot.model.spaces import ChartPoint, ChartPoints
from guidefield.scene.distance_tables import distance_tables


@dataclass(frozen=True, eq=False)
class Shape(ReadOnly):
    """A place of the waypoints, and the objective there.

    Attributes:
        path: Chart points, shape (n, nv).
        value: The objective J.
        gradient: Shape (n, nv).
        diagonal, upper: Blocks of the Hessian, shapes (n, nv, nv) and (n - 1, nv, nv).
    """

    path: ChartPoints
    value: float
    gradient: np.ndarray
    diagonal: np.ndarray
    upper: np.ndarray


@dataclass(frozen=True, eq=False)
class WaypointChain(ReadOnly):
    """What a chain of waypoints descends, and how it may move.

    Attributes:
        length: Of the path in the chart when the chain was made: its unit of length [rad or m].
        robot: Points and links.
        tables: Obstacles.
        samples: Where distances are taken.
        stiffness: Of the stretch energy between two waypoints, shape (nv,).
        units: What counts as one radian in each coordinate, shape (nv,).
        clearance: Distance from obstacles at which the barrier's wall stands [m].
        floor: Distance from obstacles below which points cost more [m].
        lower, upper: Chart limits, shape (nv,).
        near: Which obstacles were near the samples; kept up to date by looking at them.
        held: Waypoints that stay.
        crossings: What keeps waypoints on guide planes.
    """

    length: float
    robot: SampledRobot
    tables: DistanceTables
    samples: PathSamples
    stiffness: np.ndarray
    units: np.ndarray
    clearance: float
    floor: float
    lower: ChartPoint
    upper: ChartPoint
    near: NearBodies
    held: list[int]
    crossings: Mapping[int, PlaneCrossing]

    @classmethod
    def of(
        cls,
        problem: Problem,
        robot: SampledRobot,
        path: ChartPoints,
        held: list[int],
        crossings: Mapping[int, PlaneCrossing],
    ) -> WaypointChain:
        """The chain of a problem's path (n, nv), whose length isn't zero.

        Args:
            problem: Limits and obstacles.
            robot: The robot as points and links.
            path: Waypoints.
            held: Those that stay, the first and the last among them.
            crossings: What keeps waypoints on guide planes, by index.
        """
        group, units = problem.group, problem.group.units
        segments, length, tables = len(path) - 1, length_of(path), distance_tables(problem.scene)
        kept = min(obstacle_distance(robot, tables, z, BARRIER.farthest_floor) for z in path[held])
        samples = path_samples(segments, held)
        return cls(
            length=length,
            robot=robot,
            tables=tables,
            samples=samples,
            stiffness=2.0 * RELAXATION.stretch * segments / length**2 / units**2,
            units=units,
            clearance=problem.min_clearance,
            floor=float(np.clip(BARRIER.floor_share * kept, MARGIN, BARRIER.farthest_floor)),
            lower=group.lower,
            upper=group.upper,
            near=nothing_remembered(len(samples.segments), len(robot.groups)),
            held=held,
            crossings=crossings,
        )

    def at(self, path: ChartPoints) -> Shape:
        """The objective of waypoints, chart points of shape (n, nv), and its derivatives."""
        n, nv = path.shape
        gradient, diagonal, upper = np.empty((n, nv)), np.empty((n, nv, nv)), np.empty((n - 1, nv, nv))
        walls = (self.clearance, self.floor, self.near)
        value = objective(
            self.robot, self.tables, self.samples, path, self.stiffness, *walls, gradient, diagonal, upper
        )
        return Shape(path, value, gradient, diagonal, upper)

    def energy(self, shape: Shape, length: float) -> float:
        """The objective of a shape for another length of reference [rad or m]."""
        stretch = 0.5 * float((self.stiffness * np.diff(shape.path, axis=0) ** 2).sum())
        return shape.value + stretch * ((self.length / length) ** 2 - 1.0)

    def step(self, shape: Shape, damping: float) -> ChartPoints | None:
        """Newton's step (n, nv), damped; None where rounding keeps the system from being solved.

        A joint at a limit that it is pushed against stays; so does what a crossing holds.
        """
        path, gradient = shape.path, shape.gradient
        free = np.where(((path <= self.lower) & (gradient > 0.0)) | ((path >= self.upper) & (gradient < 0.0)), 0.0, 1.0)
        free[self.held] = 0.0
        diagonal, upper, right = shape.diagonal, shape.upper, -gradient
        if self.crossings:
            diagonal, upper = diagonal.copy(), upper.copy()
        for k, crossing in self.crossings.items():
            held = crossing.held_directions(path[k], right[k])
            across = np.eye(len(self.units)) - held.T @ held
            diagonal[k] = across @ diagonal[k] @ across + np.diag(self.stiffness) @ held.T @ held
            diagonal[k] = 0.5 * (diagonal[k] + diagonal[k].T)
            upper[k - 1] = upper[k - 1] @ across
            upper[k] = across @ upper[k]
            right[k] = across @ right[k]
        step = np.empty_like(path)
        return step if solve_free(diagonal, upper, right, free, damping * self.stiffness, step) else None

    def moved(self, path: ChartPoints, step: ChartPoints, stride: float) -> ChartPoints | None:
        """Waypoints after a step that is taken `stride` times, or as far as the largest step lets it be.

        Args:
            path: The waypoints, shape (n, nv) [rad or m].
            step: The step, shape (n, nv) [rad or m].
            stride: How many times it is taken.

        Returns:
            Shape (n, nv): within limits, on guide planes, what stays bit for bit; None if one can't be brought back.
        """
        longest = max(float(np.abs(step / self.units).max()), 1e-300)
        moved: ChartPoints = path + step * min(stride, RELAXATION.largest_step / longest)
        moved = np.minimum(np.maximum(moved, self.lower), self.upper)
        moved[self.held] = path[self.held]
        for k, crossing in self.crossings.items():
            back = crossing.brought_back(moved[k])
            if back is None:
                return None
            moved[k] = back
        return moved
