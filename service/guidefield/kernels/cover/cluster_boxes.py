"""Boxes about clusters of triangles: how their corners spread, and how far they reach along given axes."""

from __future__ import annotations

import math

import numpy as np
from numba import void

from guidefield.kernels.jit.signatures import (
    BLOCKS,
    BLOCKS_OUT,
    INDEX_MATRIX,
    MATRIX,
    MATRIX_OUT,
    Floats,
    Integers,
    compiled,
)


@compiled(void(BLOCKS, INDEX_MATRIX, MATRIX_OUT, BLOCKS_OUT))
def cluster_spreads(corners: Floats, members: Integers, centres_out: Floats, spreads_out: Floats) -> None:
    """Means of the corners of clusters, and sums of the products of their coordinates about those.

    Args:
        corners: Of all triangles, shape (t, 3, 3) [m].
        members: The triangles of each cluster, one of them as often as it stands there, shape (n, k).
        centres_out: Shape (n, 3) [m].
        spreads_out: Shape (n, 3, 3) [m^2].
    """
    each = members.shape[1]
    for cluster in range(members.shape[0]):
        for k in range(3):
            total = 0.0
            for i in range(each):
                for corner in range(3):
                    total += corners[members[cluster, i], corner, k]
            centres_out[cluster, k] = total / (3 * each)
        for row in range(3):
            for column in range(row + 1):
                total = 0.0
                for i in range(each):
                    for corner in range(3):
                        here = corners[members[cluster, i], corner, row] - centres_out[cluster, row]
                        total += here * (corners[members[cluster, i], corner, column] - centres_out[cluster, column])
                spreads_out[cluster, row, column] = spreads_out[cluster, column, row] = total


@compiled(void(BLOCKS, INDEX_MATRIX, MATRIX, BLOCKS, BLOCKS_OUT))
def cluster_reaches(corners: Floats, members: Integers, centres: Floats, axes: Floats, reaches_out: Floats) -> None:
    """How far clusters reach along axes from their centres.

    Args:
        corners: As there.
        members: As there.
        centres: Shape (n, 3) [m].
        axes: Three unit vectors for each cluster, one a row, shape (n, 3, 3).
        reaches_out: The least and the largest along each axis, shape (n, 2, 3) [m].
    """
    away = np.empty(3)
    for cluster in range(members.shape[0]):
        for axis in range(3):
            reaches_out[cluster, 0, axis], reaches_out[cluster, 1, axis] = math.inf, -math.inf
        for i in range(members.shape[1]):
            for corner in range(3):
                for k in range(3):
                    away[k] = corners[members[cluster, i], corner, k] - centres[cluster, k]
                for axis in range(3):
                    along = axes[cluster, axis, 0] * away[0] + axes[cluster, axis, 1] * away[1]
                    along += axes[cluster, axis, 2] * away[2]
                    reaches_out[cluster, 0, axis] = min(reaches_out[cluster, 0, axis], along)
                    reaches_out[cluster, 1, axis] = max(reaches_out[cluster, 1, axis], along)
