"""Rows of triangles against NumPy."""

from __future__ import annotations

import numpy as np

from guidefield.kernels.distance.triangle_rows import corners_and_edges, triangle_boxes


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
