"""Closed meshes of every odd kind: a cutoff, which has a ray tell what is inside, changes nothing below it."""

import numpy as np
import pytest

from guidefield.kernels.distance.distance import BOX, SOLID, distance_at_points
from tests.geometry import solids
from tests.kernels.distance.test_distance import tables_of
from tests.scene.solids import mesh_message


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
