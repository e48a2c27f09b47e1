"""Paths of seven joints, and the fastest motions along them, as tests of motions want them."""

from __future__ import annotations

import numpy as np

from guidefield.planner.motion.timing import (
    Limits,
    PathCurve,
    parameterize,
    remove_repetitions,
    stretch_spline_to_limits,
    subdivide,
)
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.path_so_far import CURVE_SPACING

# Those of a Panda, accelerations halved.
VELOCITIES = np.array([2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61])
ACCELERATIONS = np.array([7.5, 3.75, 5.0, 6.25, 7.5, 10.0, 10.0])


def walk(seed: int, n: int = 10) -> np.ndarray:
    """Waypoints with a corner at each."""
    return np.cumsum(np.random.default_rng(seed).normal(size=(n, 7)) * 0.3, axis=0)


def even(seed: int, n: int = 32) -> np.ndarray:
    """Evenly spaced waypoints on a curve that bends slowly."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, 1.0, n)[:, None]
    return rng.normal(size=7) + t * rng.normal(size=7) + np.sin(np.pi * t) * rng.normal(size=7) * 0.3


def curve_along(path: np.ndarray, finer: int = 1) -> PathCurve:
    return PathCurve.along(subdivide(remove_repetitions(path), CURVE_SPACING / finer))


def soonest(
    path: np.ndarray,
    velocities: np.ndarray | None = None,
    accelerations: np.ndarray | None = None,
    jerks: np.ndarray | None = None,
    finer: int = 1,
) -> Trajectory:
    """The fastest motion along a path; those limits that are not given are a Panda's, without any of jerk."""
    nv = path.shape[1]
    limits = Limits(
        VELOCITIES[:nv] if velocities is None else velocities,
        ACCELERATIONS[:nv] if accelerations is None else accelerations,
        np.full(nv, np.inf) if jerks is None else jerks,
    )
    return stretch_spline_to_limits(parameterize(curve_along(path, finer), limits, finer), limits)
