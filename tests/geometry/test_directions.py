"""Principal axes are those of the singular value decomposition, and the furthest points are furthest."""

from __future__ import annotations

import numpy as np
import pytest

from guidefield.geometry.directions import furthest, heights_along, spread_and_axes, spread_directions


@pytest.mark.parametrize("count", [1, 2, 3, 4, 50, 3000])
@pytest.mark.parametrize("sizes", [(1, 1, 1), (1, 1e-3, 1e-9), (1e3, 1, 0), (1e-4, 0, 0), (0, 0, 0)])
def test_axes_are_those_of_numpy(count: int, sizes: tuple[float, float, float]) -> None:
    rng = np.random.default_rng(count)
    points = rng.normal(size=(count, 3)) * sizes @ np.linalg.qr(rng.normal(size=(3, 3)))[0]
    spread, axes = spread_and_axes(points)
    _, expected, _ = np.linalg.svd(np.vstack([points, np.zeros((3, 3))]), full_matrices=False)
    np.testing.assert_allclose(spread, expected, rtol=1e-6, atol=1e-14 * expected[0])
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(np.linalg.norm(points @ axes.T, axis=0), spread, rtol=1e-6, atol=1e-14 * expected[0])


def test_axes_of_equal_spread_are_orthogonal() -> None:
    spread, axes = spread_and_axes(np.vstack([np.eye(3), -np.eye(3)]))
    np.testing.assert_allclose(spread, np.full(3, np.sqrt(2.0)))
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-15)


def test_the_furthest_are_furthest_and_heights_are_products() -> None:
    rng = np.random.default_rng(1)
    points, directions = rng.normal(size=(700, 3)), spread_directions(64)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0)
    np.testing.assert_array_equal(furthest(points, directions), (points @ directions.T).argmax(axis=0))
    assert (furthest(np.repeat(points[:1], 4, axis=0), directions) == 0).all()
    blocks = points.reshape(100, 7, 3)
    np.testing.assert_allclose(heights_along(blocks, directions[3]), blocks @ directions[3], atol=1e-14)
