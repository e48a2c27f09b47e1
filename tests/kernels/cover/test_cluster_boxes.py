"""Spreads and reaches of clusters of triangles are those of their corners."""

from __future__ import annotations

import numpy as np
import pytest

from guidefield.kernels.cover.ball_cover import cluster_reaches, cluster_spreads


@pytest.mark.parametrize("each", [1, 5, 21])
def test_against_all_corners_of_each(each: int) -> None:
    rng = np.random.default_rng(each)
    corners, members = rng.normal(size=(50, 3, 3)), rng.integers(0, 50, (7, each))
    centres, spreads, reaches = np.empty((7, 3)), np.empty((7, 3, 3)), np.empty((7, 2, 3))
    cluster_spreads(corners, members, centres, spreads)
    axes = np.linalg.qr(rng.normal(size=(7, 3, 3)))[0]
    cluster_reaches(corners, members, centres, axes, reaches)
    for k in range(7):
        points = corners[members[k]].reshape(-1, 3)
        np.testing.assert_allclose(centres[k], points.mean(axis=0), atol=1e-12)
        np.testing.assert_allclose(spreads[k], len(points) * np.cov(points.T, bias=True), atol=1e-9)
        along = (points - points.mean(axis=0)) @ axes[k].T
        np.testing.assert_allclose(reaches[k], [along.min(axis=0), along.max(axis=0)], atol=1e-12)
