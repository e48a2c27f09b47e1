"""Motions one after the other as one that doesn't stop between them: the shortest of those that are certified.

Corners are rounded first, and timed as a whole. From that motion on all are optimised as one. Where neither is shorter
than the motions with stops between them, these are it; so they are where a radius is next to nothing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from guidefield.planner.motion.trajectory import one_after_another
from guidefield.planner.path_motion import soonest_along
from guidefield.planner.sequence.corners import Rounded
from guidefield.planner.sequence.joined import Joined, Part, PassedAt, slowest
from guidefield.planner.sequence.optimized_passing import optimized_past
from guidefield.planner.sequence.rounding import passages_of, rounded_motion
from guidefield.planner.task.stages import Stages

NO_RADIUS = 1e-6
"""Goals with a radius up to this are stopped at: optimised motions pass places that closely, no closer [m, rad]."""


def join(parts: Sequence[Part], stages: Stages) -> Joined:
    """Join motions of the same joints.

    Args:
        parts: Two or more, each certified by itself.
        stages: Where time is counted.
    """
    stopping = _stopping(parts)
    if min(one.goal.radius for one in parts if one.goal is not None) <= NO_RADIUS:
        return stopping
    along = rounded_motion(parts, stages)
    first = stopping if along is None else _soonest(parts, along[1])
    found = [optimized_past(parts, first, stages), None if along is None else along[0], stopping]
    return min(filter(None, found), key=lambda one: one.motion.duration)


def _stopping(parts: Sequence[Part]) -> Joined:
    """The motions as they were planned, at rest at every goal."""
    knots = np.cumsum([max(len(one.motion.times) - 1, 0) for one in parts]).tolist()
    passages = tuple(PassedAt(knot, knot, knot, 0.0) for knot in knots[:-1])
    return Joined(one_after_another([one.motion for one in parts]), passages, stops=True)


def _soonest(parts: Sequence[Part], path: Rounded) -> Joined:
    """The time-optimal motion along rounded corners, whatever its jerk."""
    motion = soonest_along(slowest(parts), path.path)
    return Joined(motion, passages_of(motion, path, [one.goal for one in parts if one.goal is not None]))
