"""Distances of several points at once, against those of each alone, by bodies of every kind, inside, outside and on."""

from typing import Any

import numpy as np
import pytest
from numba import void

from guidefield.kernels.distance.distance import TABLES, DistanceTables, distance_at_points
from guidefield.kernels.distance.points_distance import ROWS, signed_distance_of_each
from guidefield.kernels.jit.arrays import INDICES_OUT, MATRIX, MATRIX_OUT, SCALAR, Floats
from guidefield.kernels.jit.decorators import compiled
from guidefield.kernels.simd.vector import LANES_64, load, store
from guidefield.messages import scene as messages
from tests.geometry import solids
from tests.kernels.distance.test_distance import CONVEX, TILTED, tables_of
from tests.scene.solids import l_prism, mesh_message

SQUARE = [(-0.2, -0.3, 0.1), (0.4, -0.2, 0.1), (0.3, 0.4, 0.1), (-0.3, 0.3, 0.1)]
KINDS: dict[str, Any] = {
    **CONVEX,
    "triangle": messages.Polygon(name="t", vertices=[(0.1, 0.0, 0.0), (0.5, 0.0, 0.2), (0.3, 0.4, -0.1)]),
    "polygon": messages.Polygon(name="p", vertices=SQUARE),
    "mesh": mesh_message(*l_prism(), name="m", **TILTED),
    "ring": mesh_message(*solids.torus(0.4, 0.1), name="r", **TILTED),
    "cloud": messages.PointCloud(name="c", points=[(0.1, 0.2, 0.3), (-0.3, 0.1, 0.0)], radius=0.05),
}


@compiled(void(TABLES, MATRIX, SCALAR, INDICES_OUT, MATRIX_OUT))
def _nearest(tables: DistanceTables, points: Floats, cutoff: float, bodies: np.ndarray, out: Floats) -> None:
    """Distances and axes, by rows, of points by rows, to the nearest of bodies."""
    scratch = np.empty(ROWS * LANES_64)
    for at in range(0, points.shape[1], LANES_64):
        p = load(points[0], at), load(points[1], at), load(points[2], at)
        d, nx, ny, nz = signed_distance_of_each(p, bodies, bodies.shape[0], tables, cutoff, scratch)
        store(out[0], at, d)
        store(out[1], at, nx)
        store(out[2], at, ny)
        store(out[3], at, nz)


def nearest(tables: DistanceTables, points: np.ndarray, cutoff: float) -> tuple[np.ndarray, np.ndarray]:
    """Distances (n,) and axes (n, 3) of points (n, 3)."""
    out = np.empty((4, len(points)))
    _nearest(tables, np.ascontiguousarray(points.T), cutoff, np.arange(len(tables.kinds)), out)
    return out[0], out[1:].T


def points_about(count: int) -> np.ndarray:
    return np.random.default_rng(0).uniform(-0.7, 0.7, (count, 3))


@pytest.mark.parametrize("kind", KINDS)
def test_distances_and_axes_are_those_of_each_point_alone(kind: str) -> None:
    tables, points = tables_of(KINDS[kind]), points_about(2000)
    expected, along, _ = distance_at_points(tables, points)
    found, axes = nearest(tables, points, 10.0)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-12)
    agree = np.linalg.norm(axes - along, axis=1) < 1e-6
    assert agree.mean() > 0.99, "the axis isn't unique in few places only"
    np.testing.assert_allclose(np.linalg.norm(axes, axis=1), 1.0, atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_beyond_the_cutoff_there_is_nothing(kind: str) -> None:
    tables, points = tables_of(KINDS[kind]), points_about(400)
    expected, _, _ = distance_at_points(tables, points)
    found, axes = nearest(tables, points, 0.1)
    np.testing.assert_allclose(found, np.minimum(expected, 0.1), atol=1e-12)
    assert not axes[expected > 0.1].any()


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_next_to_a_surface_the_axis_still_leads_away(kind: str) -> None:
    tables, points = tables_of(KINDS[kind]), points_about(400)
    for _ in range(3):
        distances, along, _ = distance_at_points(tables, points)
        points = points - distances[:, None] * along
    expected, _, _ = distance_at_points(tables, points)
    found, axes = nearest(tables, points, 10.0)
    np.testing.assert_allclose(found, expected, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(axes, axis=1), 1.0, atol=1e-6)


def test_of_several_bodies_the_nearest_counts_and_the_deepest_where_they_overlap() -> None:
    tables, points = tables_of(*KINDS.values()), points_about(2000)
    expected, _, _ = distance_at_points(tables, points)
    np.testing.assert_allclose(nearest(tables, points, 10.0)[0], expected, atol=1e-12)
    assert (expected < 0.0).mean() > 0.02
