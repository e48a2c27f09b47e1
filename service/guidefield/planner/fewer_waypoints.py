"""A path across guide planes with as few waypoints as its shape needs: the optimisation of a motion begins with it.

The guided planner keeps every step that it took where the straight way comes near to obstacles, and these wander. What
is looked at here is samples: the optimiser proposes, and the certificate judges.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

import numpy as np

from guidefield.planner.connect.settings import TREE
from guidefield.planner.settings import STRAIGHT_WAYS
from guidefield.planner.task.problem import Problem
from guidefield.robot.model.spaces import ChartPoints


def fewer_waypoints(problem: Problem, path: ChartPoints, crossings: Mapping[int, int]) -> ChartPoints:
    """A path with the same ends, no longer, through the same waypoints on guide planes.

    Between them straight ways are taken that keep a distance from obstacles; where there is none the path stays.

    Args:
        problem: Robot and world.
        path: Chart points, shape (n, nv).
        crossings: By index of each guide plane that was reached, its index in the path.
    """
    if problem.path_constraints:  # which a straight way would leave
        return path
    kept = sorted({0, len(path) - 1, *crossings.values()})
    margin = problem.min_clearance + STRAIGHT_WAYS.margin
    ways = [problem.lanes.shortened(path[begin : end + 1], TREE.resolution, margin) for begin, end in pairwise(kept)]
    return np.concatenate([path[:1], *(way[1:] for way in ways)])
