"""Where along a motion the distance to obstacles is taken, and how it counts there."""

from __future__ import annotations

import functools

import numpy as np

from guidefield.kernels.optimize.clearance_model import MotionSamples
from guidefield.planner.optimize.bspline import BSpline, basis
from guidefield.planner.optimize.settings import OptimizationSettings
from guidefield.read_only import read_only


def clearance_samples(
    spline: BSpline, kept: tuple[float, float], clearance: float, samples: int, settings: OptimizationSettings
) -> MotionSamples:
    """Samples evenly in time, each of which counts by the joint distance that it stands for.

    Args:
        spline: The motion.
        kept: What its start and its end keep from obstacles [m].
        clearance: What is asked for [m].
        samples: How many on a piece.
        settings: Of the optimisation.
    """
    bounds, pieces, of_pieces, shares = places(spline.pieces, samples)
    lengths = np.linalg.norm(np.diff(spline.at(bounds), axis=0), axis=1)
    total = max(float(lengths.sum()), 1e-300)
    until = np.cumsum(lengths) - 0.5 * lengths
    from_end = np.minimum(until, total - until)
    near = np.minimum(from_end / settings.ramp, 1.0)
    least = np.where(until < 0.5 * total, *(_floor(one, settings) for one in kept))
    rise = np.minimum(from_end / settings.floor_ramp, 1.0) ** 2
    far = float(np.clip(settings.floor_share * min(kept), settings.floor, settings.farthest_floor)) + clearance
    placed = MotionSamples(
        pieces=pieces,
        basis=of_pieces,
        weights=settings.weight / total * lengths * (1.0 + settings.end_weight * (1.0 - near)),
        ranges=settings.range * (settings.least_range + (1.0 - settings.least_range) * near),
        floors=least + (np.maximum(far, least) - least) * rise,
        shares=shares,
    )
    read_only(*placed)
    return placed


def _floor(kept: float, settings: OptimizationSettings) -> float:
    """Below which distance points cost more at an end that keeps so much [m]."""
    return float(np.clip(settings.floor_share * kept, settings.least_floor, settings.floor))


@functools.lru_cache(maxsize=256)
def places(pieces: int, samples: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Where so many samples on each of some pieces are.

    Returns:
        The bounds between them, shape (s + 1,), in pieces from the start; the piece of each, shape (s,); the basis
        there, shape (s, 4); how much each counts between links, shape (s,).
    """
    bounds = np.arange(pieces * samples + 1) / samples
    middles = 0.5 * (bounds[:-1] + bounds[1:])
    of_samples = middles.astype(np.int64)
    shares = np.where(np.arange(pieces * samples) % 2 == 0, 2.0, 0.0)
    made = bounds, of_samples, basis(middles - of_samples), shares
    read_only(*made)
    return made
