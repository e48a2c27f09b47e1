"""Where along a motion the distance to obstacles is taken, and how it counts there."""

from __future__ import annotations

import functools
from typing import cast

import numpy as np

from guidefield.kernels.optimize.clearance_model import MotionSamples
from guidefield.planner.motion.bspline import BSpline, basis
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.optimize.settings import OptimizationSettings
from guidefield.read_only import read_only
from guidefield.robot.model.spaces import ChartPoints


def clearance_samples(
    spline: BSpline,
    kept: tuple[float, float],
    clearance: float,
    samples: int,
    settings: OptimizationSettings,
    *,
    in_time: bool = False,
) -> MotionSamples:
    """Samples evenly in time, each of which counts by the joint distance that it stands for.

    Args:
        spline: The motion.
        kept: What its start and its end keep from obstacles [m].
        clearance: What is asked for [m].
        samples: How many on a piece.
        settings: Of the optimisation.
        in_time: Whether obstacles move. Then it counts by half of that, and half of its share of time: they come to a
            robot that stands, too.
    """
    bounds, middles, pieces, of_pieces, shares = places(spline.pieces, samples)
    counts = _counts(spline.at(bounds), kept, clearance, settings, in_time=in_time)
    placed = MotionSamples(pieces, middles, of_pieces, *counts, shares)
    read_only(*placed)
    return placed


def samples_in_time(
    motion: Trajectory, kept: tuple[float, float], clearance: float, samples: int, settings: OptimizationSettings
) -> tuple[MotionSamples, ChartPoints]:
    """The same of a motion that is no spline, among obstacles that move.

    Args:
        motion: Without the wait before it.
        kept: As in `clearance_samples` [m].
        clearance: What is asked for [m].
        samples: How many.
        settings: Of the optimisation.

    Returns:
        The samples, each at a control point of its own, their places being times [s]; the points, shape
        (samples + 3, nv).
    """
    bounds = motion.times[0] + motion.duration * np.arange(samples + 1) / samples
    middles = 0.5 * (bounds[:-1] + bounds[1:])
    counts = _counts(motion.evaluate(bounds)[0], kept, clearance, settings, in_time=True)
    each = np.tile([1.0, 0.0, 0.0, 0.0], (samples, 1))
    placed = MotionSamples(np.arange(samples), middles, each, *counts, np.ones(samples))
    read_only(*placed)
    points = motion.evaluate(middles)[0]
    return placed, cast(ChartPoints, np.concatenate([points, points[-3:]]))


def _counts(
    zs: ChartPoints, kept: tuple[float, float], clearance: float, settings: OptimizationSettings, *, in_time: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weights, ranges and floors of samples between chart points (s + 1, nv), each of shape (s,)."""
    lengths = np.linalg.norm(np.diff(zs, axis=0), axis=1)
    total = max(float(lengths.sum()), 1e-300)
    until = np.cumsum(lengths) - 0.5 * lengths
    from_end = np.minimum(until, total - until)
    near = np.minimum(from_end / settings.ramp, 1.0)
    least = np.where(until < 0.5 * total, *(_floor(one, settings) for one in kept))
    rise = np.minimum(from_end / settings.floor_ramp, 1.0) ** 2
    stands_for = 0.5 * (lengths + total / len(lengths)) if in_time else lengths
    far = float(np.clip(settings.floor_share * min(kept), settings.floor, settings.farthest_floor)) + clearance
    return (
        settings.weight / total * stands_for * (1.0 + settings.end_weight * (1.0 - near)),
        settings.range * (settings.least_range + (1.0 - settings.least_range) * near),
        least + (np.maximum(far, least) - least) * rise,
    )


def _floor(kept: float, settings: OptimizationSettings) -> float:
    """Below which distance points cost more at an end that keeps so much [m]."""
    return float(np.clip(settings.floor_share * kept, settings.least_floor, settings.floor))


@functools.lru_cache(maxsize=256)
def places(pieces: int, samples: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Where so many samples on each of some pieces are.

    Returns:
        The bounds between them, shape (s + 1,), in pieces from the start; where each is, shape (s,), and its piece; the
        basis there, shape (s, 4); how much each counts between links, shape (s,).
    """
    bounds = np.arange(pieces * samples + 1) / samples
    middles = 0.5 * (bounds[:-1] + bounds[1:])
    of_samples = middles.astype(np.int64)
    shares = np.where(np.arange(pieces * samples) % 2 == 0, 2.0, 0.0)
    made = bounds, middles, of_samples, basis(middles - of_samples), shares
    read_only(*made)
    return made
