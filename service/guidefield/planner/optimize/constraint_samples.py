"""Where along a motion path constraints are looked at, and which of them: not all hold all along."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from guidefield.kernels.optimize.constraint_penalty import KeptSamples
from guidefield.planner.optimize.clearance_samples import places
from guidefield.planner.optimize.settings import OptimizationSettings
from guidefield.read_only import ReadOnly
from guidefield.robot.group.kept_frames import kept_frames
from guidefield.robot.group.path_constraints import ConstrainedFrames


@dataclass(frozen=True, eq=False)
class Sections(ReadOnly):
    """Path constraints, and where they hold along a motion.

    A motion has a section before its first passage, one between each and the next, and one after the last. Some
    constraints hold all along; others are groups of alternatives, one of which holds at any time.

    Attributes:
        frames: The constraints, k of them.
        groups: Which group each is of, in ascending order, shape (k,); -1: it holds all along. Of groups that cost as
            little the first is kept.
        asked: Whether each is looked at on a section, 1 or 0, shape (sections, k).
    """

    frames: ConstrainedFrames
    groups: np.ndarray
    asked: np.ndarray

    @classmethod
    def whole(cls, frames: ConstrainedFrames, passages: int = 0) -> Sections:
        """Constraints that hold all along a motion with so many passages."""
        count = len(frames.constraints)
        return cls(frames, np.full(count, -1, np.int64), np.ones((passages + 1, count), np.int64))


def constraint_samples(
    sections: Sections, pieces: int, passed: Sequence[float], samples: int, settings: OptimizationSettings
) -> KeptSamples:
    """Samples evenly in time, next to those of the clearance and between them.

    Args:
        sections: The constraints.
        pieces: How many the motion has.
        passed: Where it comes nearest to each passage, in pieces from the start.
        samples: At which the clearance is looked at, on a piece.
        settings: Of the optimisation.
    """
    bounds, _, of_samples, shares, _ = places(pieces, settings.constraint_samples * samples)
    asked = sections.asked[np.searchsorted(np.array(passed), bounds[:-1], side="right")]
    asked.setflags(write=False)
    return KeptSamples(
        kept_frames(sections.frames),
        of_samples,
        shares,
        sections.groups,
        asked,
        settings.constraint_room,
        settings.constraint_weight,
        settings.tight,
    )
