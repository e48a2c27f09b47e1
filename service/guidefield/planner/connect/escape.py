"""Whether a configuration can be left at all: short motions in every direction, where long ones all failed."""

from __future__ import annotations

import numpy as np

from guidefield.collision.lanes.lanes import BatchCollision
from guidefield.planner.connect.settings import ESCAPE
from guidefield.robot.model.spaces import ChartPoints


def can_be_left(
    lanes: BatchCollision, roots: ChartPoints, clearance: float, resolution: float, rng: np.random.Generator
) -> bool:
    """Whether any of many short motions out of some configurations is free.

    Args:
        lanes: Robot and obstacles.
        roots: Chart points, shape (k, nv), free.
        clearance: What to keep from obstacles [m].
        resolution: Samples of a motion per length in the chart [1/rad or 1/m].
        rng: Chooses directions.
    """
    group, along = lanes.world.group, np.eye(lanes.world.group.nv)
    drawn = rng.normal(size=(ESCAPE.directions, group.nv))
    directions = np.concatenate([along, -along, drawn / np.linalg.norm(drawn, axis=1)[:, None]])
    for root in roots:
        for length in ESCAPE.lengths:
            ends = np.clip(root + length * directions, group.lower, group.upper)
            ends = ends[np.linalg.norm(ends - root, axis=1) > 0.5 * length]
            for end in ends[~lanes.touching(ends, clearance)]:
                if lanes.free_until(np.array([root, end]), resolution, clearance):
                    return True
    return False
