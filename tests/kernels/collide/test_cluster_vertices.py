"""Corners of clusters stand in blocks of sixteen, and places that are left repeat the first."""

from __future__ import annotations

import numpy as np
import pytest

from guidefield.kernels.collide.parts import write_cluster_vertices
from guidefield.kernels.simd.vector_model import LANES


@pytest.mark.parametrize("each", [1, 5, 6, 21])
def test_blocks_hold_the_corners_in_order(each: int) -> None:
    rng = np.random.default_rng(each)
    corners, members = rng.normal(size=(30, 3, 3)), rng.integers(0, 30, (4, each))
    blocks = -(-3 * each // LANES)
    vertices = np.full(4 * blocks * 3 * LANES, np.nan, np.float32)
    write_cluster_vertices(corners, members, vertices)
    rows = vertices.reshape(4, blocks, 3, LANES).transpose(0, 1, 3, 2).reshape(4, blocks * LANES, 3)
    for row, cluster in zip(rows, members, strict=True):
        wanted = corners[cluster].reshape(-1, 3).astype(np.float32)
        np.testing.assert_array_equal(row[: 3 * each], wanted)
        np.testing.assert_array_equal(row[3 * each :], np.repeat(wanted[:1], blocks * LANES - 3 * each, axis=0))
