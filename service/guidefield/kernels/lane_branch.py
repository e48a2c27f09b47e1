"""The path through two trees that have met."""

from __future__ import annotations

import math

import numpy as np
from numba import int64, types

from guidefield.kernels.lane_nodes import MEETING, ROOT, search_of
from guidefield.kernels.lane_samples import sampling_of
from guidefield.kernels.lanes import lane_kernel, pointers
from guidefield.kernels.packing import Words
from guidefield.kernels.tree_kinematics import INDICES

_POINTS_OUT = types.Array(types.float64, 2, "C")


@lane_kernel(int64(INDICES, INDICES, _POINTS_OUT))
def joined(sampling: Words, search: Words, path_out: np.ndarray) -> int:
    """The branch from the root of the first tree and that to the root of the second, once they have met.

    The trees met where a step of the one towards the other's last point would end. Whole turns are added to the second
    branch, so that no coordinate that wraps goes more than half a turn from point to point.

    Args:
        sampling: Where samples come from, a packed `Sampling`.
        search: The trees, a packed `Search`; the roots are written into its counters.
        path_out: Chart points, shape (n, nv) with as many rows as there are nodes [rad or m].

    Returns:
        How many rows were written.
    """
    period, trees = sampling_of(pointers(sampling)).period, search_of(pointers(search))
    nv, capacity, counters, parents, nodes = trees.nv, trees.capacity, trees.counters, trees.parents, trees.nodes
    first, node = 0, counters[MEETING]
    while parents[node] >= 0:
        first += 1
        node = parents[node]
    counters[ROOT] = node
    node = counters[MEETING]
    for row in range(first, -1, -1):
        for j in range(nv):
            path_out[row, j] = nodes[j * capacity + node]
        node = parents[node]
    row, node = first + 1, counters[MEETING + 1]
    while node >= 0:
        counters[ROOT + 1] = node
        for j in range(nv):
            place = float(nodes[(nv + j) * capacity + node])
            if period[j] != 0.0:
                place += 2.0 * math.pi * np.rint((path_out[row - 1, j] - place) / (2.0 * math.pi))
            path_out[row, j] = place
        row, node = row + 1, parents[capacity + node]
    return row
