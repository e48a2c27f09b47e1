"""Where along a motion path constraints are looked at."""

from __future__ import annotations

from guidefield.kernels.optimize.constraint_penalty import KeptSamples
from guidefield.kernels.tree.path_constraints import KeptFrames
from guidefield.planner.optimize.clearance_samples import places
from guidefield.planner.optimize.settings import OptimizationSettings


def constraint_samples(frames: KeptFrames, pieces: int, samples: int, settings: OptimizationSettings) -> KeptSamples:
    """Samples evenly in time, next to those of the clearance and between them.

    Args:
        frames: The constraints.
        pieces: How many the motion has.
        samples: At which the clearance is looked at, on a piece.
        settings: Of the optimisation.
    """
    _, of_samples, shares, _ = places(pieces, settings.constraint_samples * samples)
    return KeptSamples(frames, of_samples, shares, settings.constraint_room, settings.constraint_weight, settings.tight)
