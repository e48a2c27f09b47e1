"""The smallest clearance along a motion, for the benchmarks: exact to a tenth of a millimetre."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from guidefield.collision.world import World
from guidefield.prove.curve import Curve
from guidefield.prove.places import Surveyor
from guidefield.prove.smallest import Question, smallest
from guidefield.prove.timed_world import TimedWorld

FIRST_PLACES = 50
"""Where the search for the smallest distances begins, breaks apart."""


def smallest_along(world: World, curve: Curve, spans: Sequence[tuple[float, float]]) -> list[float]:
    """The smallest distance from obstacles [m] within each of some spans of a curve's time, among what rests."""
    surveyor = Surveyor(TimedWorld.of(world, world), curve)
    even = np.linspace(curve.times[0], curve.times[-1], FIRST_PLACES)
    places = surveyor.places(np.unique(np.concatenate([even, curve.breaks, np.ravel(spans)])))
    mixed = np.arange(len(world.pairs)) >= world.pairs.n_self
    questions = [Question(mixed, *span) for span in spans]
    return [found.distance for found in smallest(surveyor, places, questions)]
