"""The path through two trees that have met."""

from __future__ import annotations

import math

import numpy as np
from numba import void

from guidefield.kernels.jit.signatures import lane_part, lane_step
from guidefield.kernels.tree.informed_samples import SAMPLING, Sampling
from guidefield.kernels.tree.nodes import MEETING, ROOTS, ROWS, SEARCH, TreeSearch


@lane_part
def _turned_near(place: float, before: float, period: float) -> float:
    """A coordinate, if it wraps with whole turns added so that it is no more than half a turn from another."""
    if period != 0.0:
        place += 2.0 * math.pi * np.rint((before - place) / (2.0 * math.pi))
    return place


@lane_step(void(SAMPLING, SEARCH, ROOTS, ROOTS))
def join(sampling: Sampling, search: TreeSearch, starts: np.ndarray, goals: np.ndarray) -> None:
    """Write the branch from the root of the first tree and that to the root of the second, which have met.

    The trees met where a step of the one towards the other's last point would end. Whole turns are added to the second
    branch, so that no coordinate that wraps goes more than half a turn from point to point. Nodes are float32, so the
    ends are the roots as they were given.

    Args:
        sampling: Which coordinates wrap.
        search: The trees; gets the path, and how many rows it has.
        starts: Roots of the first tree, shape (k, nv).
        goals: Roots of the second, shape (m, nv).
    """
    nv, capacity, counters, parents = search.nv, search.capacity, search.counters, search.parents
    nodes, path, row, node = search.nodes, search.path, 0, counters[MEETING]
    while parents[node] >= 0:
        row += 1
        node = parents[node]
    for j in range(nv):
        path[j] = starts[node, j]
    counters[ROWS], node = row + 1, counters[MEETING]
    while row > 0:
        for j in range(nv):
            path[row * nv + j] = nodes[j * capacity + node]
        row, node = row - 1, parents[node]
    row, node = counters[ROWS], counters[MEETING + 1]
    while node >= 0:
        above = parents[capacity + node]
        for j in range(nv):
            place = float(nodes[(nv + j) * capacity + node])
            if above < 0:
                place = goals[node, j]
            path[row * nv + j] = _turned_near(place, path[(row - 1) * nv + j], sampling.period[j])
        row, node = row + 1, above
    counters[ROWS] = row
