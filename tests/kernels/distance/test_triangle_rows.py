"""Rows of triangles against NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from guidefield.kernels.distance.triangle_rows import corner_sums, corners_and_edges, runs_of_triangles, triangle_boxes


def test_rows_are_those_of_numpy() -> None:
    rng = np.random.default_rng(0)
    vertices, triangles = rng.normal(size=(20, 3)), rng.integers(0, 20, (50, 3))
    order = rng.permutation(50)[:30]
    a, b, c = np.moveaxis(vertices[triangles], 1, 0)
    boxes, rows = np.empty((50, 6)), np.empty((30, 9))
    triangle_boxes(vertices, triangles, boxes)
    corners_and_edges(vertices, triangles, order, rows)
    assert (boxes == np.hstack([np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)])).all()
    assert (rows == np.hstack([a, b - a, c - a])[order]).all()


@pytest.mark.parametrize("count", [1, 7, 8, 50])
def test_runs_are_those_of_numpy(count: int) -> None:
    rng = np.random.default_rng(count)
    vertices, triangles, order = rng.normal(size=(20, 3)), rng.integers(0, 20, (count, 3)), rng.permutation(count)
    a, b, c = np.moveaxis(vertices[triangles], 1, 0)
    sums, rows, boxes = np.empty((count, 3)), np.empty((count, 3), np.int32), np.empty((-(-count // 8), 6))
    corner_sums(vertices, triangles, sums)
    runs_of_triangles(vertices, triangles, order, 8, rows, boxes)
    assert (sums == a + b + c).all()
    assert (rows == triangles[order]).all()
    for run, box in enumerate(boxes):
        corners = vertices[triangles[order[8 * run : 8 * run + 8]]].reshape(-1, 3)
        assert (box == [*corners.min(axis=0), *corners.max(axis=0)]).all()
