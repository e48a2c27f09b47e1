"""The smallest clearance along a motion, for the benchmarks: exact to a tenth of a millimetre."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from guidefield.collision.world import World
from guidefield.prove.curve import Curve
from guidefield.prove.minima import smallest_along as search_along

SAMPLES = 50
"""Number of samples that the search begins with, evenly apart."""


def smallest_along(world: World, curve: Curve, spans: Sequence[tuple[float, float]]) -> list[float]:
    """Return the smallest distance from obstacles [m] within each of some spans of a curve's time, the whole first."""
    samples = np.linspace(curve.times[0], curve.times[-1], SAMPLES)
    return [found.distance for found in search_along(world, curve, samples, spans).obstacle]
