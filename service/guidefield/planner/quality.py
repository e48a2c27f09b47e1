"""How good a motion is: its distance from everything along the way, its length and its smoothness."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from guidefield.planner.problem import Problem
from guidefield.planner.trajectory import Trajectory
from guidefield.robot.kinematics import Kinematics

SPACING = 0.05
"""Joint distance between samples of the clearance [rad or m]."""
MOST_SAMPLES = 100
END_STRETCH = 0.3
"""Joint distance at each end that the inner clearance leaves out [rad]."""


@dataclass(frozen=True, eq=False)
class ClearanceProfile:
    """Distances along a motion, exact at its samples.

    Attributes:
        times: Shape (n,) [s].
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
    configurations: np.ndarray
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

    @property
    def inner(self) -> float | None:
        """Smallest distance to obstacles less `END_STRETCH` of the way at each end; None if nothing is left."""
        inside = (self.lengths >= END_STRETCH) & (self.lengths <= self.lengths[-1] - END_STRETCH)
        return float(self.obstacle_distance[inside].min()) if inside.any() else None


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


def clearance_profile(trajectory: Trajectory, problem: Problem) -> ClearanceProfile:
    """Sample distances and potential evenly along a trajectory, among the obstacles as they then stand."""
    times, lengths = _even_times(trajectory)
    positions = trajectory.evaluate(times)[0]
    qs = np.array([problem.group.from_chart(z) for z in positions])
    then = [problem.at(time) for time in times]
    found = [at.world.clearance(q) for at, q in zip(then, qs, strict=True)]
    far = np.full((2, 3), np.nan)
    return ClearanceProfile(
        times=times,
        configurations=qs,
        lengths=lengths,
        obstacle_distance=np.array([c.obstacle_distance for c in found]),
        obstacle_pair=tuple(c.obstacle_pair for c in found),
        witness=np.array([far if c.witness is None else c.witness for c in found]),
        self_distance=np.array([c.self_distance for c in found]),
        self_pair=tuple(c.self_pair for c in found),
        potentials=lambda: np.array([at.robot_field.potential(q) for at, q in zip(then, qs, strict=True)]),
    )


def figures(trajectory: Trajectory, kinematics: Kinematics) -> Figures:
    """Length, duration and smoothness of a trajectory."""
    samples = trajectory.evaluate(np.linspace(0.0, trajectory.duration, 400))[0]
    steps = np.diff(samples, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    tips = np.array([kinematics.tip_position(kinematics.group.from_chart(z)) for z in samples])
    return Figures(
        joint_path_length=float(lengths.sum()),
        tip_path_length=float(np.linalg.norm(np.diff(tips, axis=0), axis=1).sum()),
        duration=trajectory.duration,
        peak_jerk=trajectory.peak_jerk,
        smoothness=_bending(trajectory),
    )


def _even_times(trajectory: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Times at which a trajectory has travelled equal joint distances, and those distances."""
    fine = np.linspace(0.0, trajectory.duration, 20 * len(trajectory.times) + 2)
    travelled = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(trajectory.evaluate(fine)[0], axis=0), axis=1))]
    count = int(np.clip(np.ceil(travelled[-1] / SPACING) + 1, 2, MOST_SAMPLES))
    lengths = np.linspace(0.0, travelled[-1], count)
    return np.interp(lengths, travelled, fine), lengths


def _bending(trajectory: Trajectory) -> float:
    """Integral of the squared curvature by length, times the length."""
    times, lengths = _even_times(trajectory)
    if lengths[-1] <= 0.0 or len(times) < 3:
        return 0.0
    points = trajectory.evaluate(times)[0]
    directions = np.diff(points, axis=0)
    norms = np.linalg.norm(directions, axis=1)
    cosines = np.einsum("ij,ij->i", directions[1:], directions[:-1]) / np.maximum(norms[1:] * norms[:-1], 1e-30)
    turns = np.arccos(np.clip(cosines, -1.0, 1.0))
    return float((turns**2).sum() / lengths[1] * lengths[-1])
