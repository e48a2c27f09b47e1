"""The corners of clusters of triangles as blocks of vertices."""

from __future__ import annotations

import numpy as np
from numba import void

from guidefield.kernels.jit.signatures import BLOCKS, FLOATS_OUT, INDEX_MATRIX, Floats, Floats32, Integers, compiled
from guidefield.kernels.simd.blocks import BLOCK
from guidefield.kernels.simd.vector_model import LANES


@compiled(void(BLOCKS, INDEX_MATRIX, FLOATS_OUT))
def write_cluster_vertices(corners: Floats, members: Integers, vertices_out: Floats32) -> None:
    """Write the vertices of clusters, cluster by cluster.

    Args:
        corners: Of all triangles, shape (t, 3, 3) [m].
        members: The triangles of each cluster, shape (n, k).
        vertices_out: Their corners, as `Parts.vertices` has them, and the first one wherever places are left; shape
            (BLOCK * blocks of all,).
    """
    each = members.shape[1]
    blocks = (3 * each + LANES - 1) // LANES
    for cluster in range(members.shape[0]):
        for place in range(LANES * blocks):
            which = place if place < 3 * each else 0
            triangle, corner = members[cluster, which // 3], which % 3
            at = BLOCK * (blocks * cluster + place // LANES) + place % LANES
            for k in range(3):
                vertices_out[at + LANES * k] = np.float32(corners[triangle, corner, k])
