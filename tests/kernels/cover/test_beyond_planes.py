"""Points beyond planes, looked through by NumPy, and planes that touch hulls."""

from __future__ import annotations

import numpy as np
import pytest

from guidefield.geometry.convex import convex_hull, hull_planes
from guidefield.kernels.cover.cut_halves import beyond_any


@pytest.mark.parametrize("rounding", [0.0, 0.1])
def test_points_beyond_any_plane_are_those_of_numpy(rounding: float) -> None:
    rng = np.random.default_rng(3)
    hull, points = convex_hull(rng.normal(size=(40, 3))), 1.5 * rng.normal(size=(2000, 3))
    planes, beyond = hull_planes(hull, len(hull.triangles)), np.empty(len(points), np.bool_)
    beyond_any(points, planes, rounding, beyond)
    np.testing.assert_array_equal(beyond, ((points @ planes[:, :3].T - planes[:, 3]) > rounding).any(axis=1))
    assert 100 < np.count_nonzero(beyond) < 1900


def test_planes_of_a_hull_touch_it_the_largest_triangles_first() -> None:
    hull = convex_hull(np.random.default_rng(4).normal(size=(60, 3)))
    planes = hull_planes(hull, 20)
    assert planes.shape == (20, 4)
    heights = hull.vertices @ planes[:, :3].T - planes[:, 3]
    assert heights.max(axis=0) == pytest.approx(np.zeros(20), abs=1e-12)
    a, b, c = np.moveaxis(hull.corners, 1, 0)
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    largest = np.cross(b - a, c - a)[areas.argmax()] / areas.max()
    np.testing.assert_allclose(planes[0, :3], largest, atol=1e-12)
    assert len(hull_planes(hull, 10**6)) == len(hull.triangles)
