"""Distances of several points are those of each; of odd closed meshes a cutoff changes nothing below it."""

from typing import Any

import numpy as np
import pytest
from numba import void

from guidefield.kernels.distance.distance import BOX, SOLID, TABLES, DistanceTables, distance_at_points
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


def scaled(mesh: solids.Mesh, factor: float) -> solids.Mesh:
    return mesh[0] * factor, mesh[1]


def shells(*sizes: float) -> solids.Mesh:
    """Boxes in one another, every second of them a hollow."""
    boxes = [solids.box((size, 1.1 * size, 0.9 * size)) for size in sizes]
    return solids.together(*(solids.turned(one) if k % 2 else one for k, one in enumerate(boxes)))


def sliver() -> solids.Mesh:
    """A prism with two long sides that are a thousandth of their length apart."""
    return solids.box((0.4, 0.0004, 0.3))


CLOSED = {
    "ring": solids.torus(),
    "lying ring": solids.lying(solids.torus(), 2),
    "fine ring": solids.torus(around=200, across=24),
    "thin ring": solids.torus(0.3, 0.001, 90, 8),
    "inside out": solids.turned(solids.torus()),
    "channel": solids.channel(),
    "hollow": solids.hollow(),
    "thin shell": shells(0.2, 0.1999),
    "nested shells": shells(0.4, 0.35, 0.2, 0.15),
    "touching at a corner": solids.together(solids.box((0.1, 0.1, 0.1)), solids.box((0.1, 0.1, 0.1), (0.1, 0.1, 0.1))),
    "touching at an edge": solids.together(solids.box((0.1, 0.1, 0.1)), solids.box((0.1, 0.1, 0.1), (0.1, 0.1, 0.0))),
    "overlapping": solids.overlapping(),
    "far apart": solids.together(solids.torus(), solids.box((0.1, 0.1, 0.1), (3.0, 0.1, 0.0))),
    "sliver": sliver(),
    "tiny": scaled(solids.torus(), 1e-3),
    "huge": scaled(solids.lying(solids.channel(), 4), 1e4),
}

BOXES = {"touching at a corner", "touching at an edge", "overlapping", "sliver"}  # of solids that are boxes


def asked_at(mesh: solids.Mesh, seed: int) -> np.ndarray:
    """Places in the box about a mesh, on its axes, near its surface, and next to where its corners are."""
    rng, (low, high) = np.random.default_rng(seed), (mesh[0].min(axis=0), mesh[0].max(axis=0))
    middle, size = 0.5 * (low + high), np.linalg.norm(high - low)
    axes = middle + 0.5 * (high - low) * np.linspace(-1.2, 1.2, 13)[:, None, None] * np.eye(3)
    near = solids.on_surface(mesh, 60, rng)
    near = near[rng.choice(len(near), 60)] + rng.normal(size=(60, 3)) * size * 10.0 ** rng.uniform(-7, -2, (60, 1))
    return np.concatenate([solids.in_box_of(mesh, 120, rng), axes.reshape(-1, 3), near, middle[None]])


@pytest.mark.parametrize("share", [0.003, 0.2])
@pytest.mark.parametrize("name", CLOSED)
def test_a_cutoff_changes_nothing_below_it(name: str, share: float) -> None:
    mesh = CLOSED[name]
    tables = tables_of(mesh_message(*mesh))
    kinds = {BOX} if name in BOXES else {BOX, SOLID} if name == "far apart" else {SOLID}
    assert set(tables.kinds.tolist()) == kinds
    points, cutoff = asked_at(mesh, 1), share * float(np.ptp(mesh[0], axis=0).max())
    whole, cut = distance_at_points(tables, points), distance_at_points(tables, points, cutoff)
    near = whole[0] < cutoff
    for a, b in zip(whole, cut, strict=True):
        np.testing.assert_array_equal(a[near], b[near])
    assert (cut[0][~near] == np.inf).all()
    assert (cut[2][~near] == -1).all()


@pytest.mark.parametrize("mesh", CLOSED.values(), ids=CLOSED)
def test_sides_are_those_that_solid_angles_tell(mesh: solids.Mesh) -> None:
    tables, points = tables_of(mesh_message(*mesh)), asked_at(mesh, 2)
    size = float(np.ptp(mesh[0], axis=0).max())
    apart = solids.distance(points, mesh)
    points, apart = points[apart > 1e-9 * size], apart[apart > 1e-9 * size]
    inside = np.rint(np.abs(solids.winding(points, mesh))) > 0
    for cutoff in (0.002 * size, 0.05 * size):
        found = distance_at_points(tables, points, cutoff)[0]
        assert ((found < 0.0) == inside).all()
        seen = ~inside & (apart < 0.999 * cutoff)
        np.testing.assert_allclose(found[seen], apart[seen], rtol=1e-9, atol=1e-12 * size)
        # where solids overlap the depth is that in one of them, which is no farther than the nearest surface of all
        assert (-found[inside] >= apart[inside] - 1e-12 * size).all()
