from __future__ import annotations

import math

import numpy as np
import pytest

from guidefield.geometry import surfaces
from guidefield.geometry.charged import field_tables
from guidefield.geometry.charges import surface_points
from guidefield.geometry.surfaces import Surface
from guidefield.kernels.field.field import field_at_points
from tests.geometry.measures import areas
from tests.oracles import distance_to_triangle

SHAPES = {
    "box": (surfaces.box((0.3, 0.5, 0.4)), 0.1),
    "plate": (surfaces.box((0.5, 0.002, 0.4)), 0.08),
    "cylinder": (surfaces.cylinder(0.1, 0.6), 0.08),
    "sphere": (surfaces.sphere(0.2), 0.1),
    "small for its spacing": (surfaces.box((0.01, 0.01, 0.01)), 0.1),
    "sliver": (surfaces.surface(np.array([[0, 0, 0], [1, 0, 0], [0.5, 1e-6, 0]]), np.array([[0, 1, 2]])), 0.1),
}

shapes = pytest.mark.parametrize(("shape", "spacing"), SHAPES.values(), ids=SHAPES)


@shapes
def test_points_lie_on_the_surface_with_its_normals(shape: Surface, spacing: float) -> None:
    charges = surface_points(*shape, spacing)
    for point, normal in zip(charges.points, charges.normals, strict=True):
        distances = [distance_to_triangle(point, corners) for corners in shape.corners]
        assert min(distances) < 1e-12
        a, b, c = shape.corners[int(np.argmin(distances))]
        across = np.cross(b - a, c - a)
        assert normal == pytest.approx(across / np.linalg.norm(across), abs=1e-9)


@shapes
def test_weights_share_the_area(shape: Surface, spacing: float) -> None:
    charges = surface_points(*shape, spacing)
    assert charges.weights.sum() == pytest.approx(areas(shape).sum())
    assert (charges.weights > 0.0).all()
    # No share is larger than the disc that its point may have to itself, on both sides of a thin plate.
    assert charges.weights.max() <= 2.0 * math.pi * spacing**2


@shapes
def test_points_keep_their_distance_and_leave_no_gap(shape: Surface, spacing: float) -> None:
    charges = surface_points(*shape, spacing)
    between = np.linalg.norm(charges.points[:, None] - charges.points[None], axis=2)
    assert (between + np.diag(np.full(len(between), np.inf)) >= spacing).all()
    rng = np.random.default_rng(1)
    owners = rng.choice(len(shape.triangles), size=2000, p=areas(shape) / areas(shape).sum())
    shares = rng.dirichlet((1.0, 1.0, 1.0), size=2000)
    samples = np.einsum("ij,ijk->ik", shares, shape.corners[owners])
    nearest = np.linalg.norm(samples[:, None] - charges.points[None], axis=2).min(axis=1)
    # The candidates are an eighth of the spacing apart, and hardly ever more than twice that.
    assert nearest.max() <= 1.25 * spacing


def test_weights_are_about_even() -> None:
    weights = surface_points(*surfaces.sphere(1.0), 0.3).weights
    assert 0.5 * weights.mean() < weights.min()
    assert weights.max() < 1.7 * weights.mean()


def test_weighted_sums_tend_to_the_integral() -> None:
    # Of the field of a ball over the faces of a box, by a fine grid on each.
    box, ball = surfaces.box((0.3, 0.5, 0.4)), field_tables(spheres=[[0.6, 0.1, 0.0, 0.2, 1.0]])
    steps = (np.arange(100) + 0.5) / 100 - 0.5
    u, v = (grid.ravel() for grid in np.meshgrid(steps, steps))
    size = np.array([0.3, 0.5, 0.4])
    exact = 0.0
    for axis in range(3):
        for side in (-0.5, 0.5):
            grid = np.insert(np.column_stack([u, v]), axis, side, axis=1) * size
            exact += field_at_points(ball, grid).potential.mean() * np.prod(np.delete(size, axis))
    for spacing, accuracy in ((0.1, 0.1), (0.03, 0.02)):
        charges = surface_points(*box, spacing)
        assert charges.weights @ field_at_points(ball, charges.points).potential == pytest.approx(exact, rel=accuracy)


def test_the_same_surface_gives_the_same_points() -> None:
    cylinder = surfaces.cylinder(0.1, 0.6)
    first, second = surface_points(*cylinder, 0.08), surface_points(*cylinder, 0.08)
    assert (first.points == second.points).all()
    assert (first.weights == second.weights).all()
    assert not first.points.flags.writeable


def test_triangles_without_area_do_not_matter() -> None:
    box = surfaces.box((0.3, 0.5, 0.4))
    with_slits = surfaces.surface(box.vertices, np.vstack([[[0, 0, 1]], box.triangles, [[3, 3, 3]]]))
    first, second = surface_points(*box, 0.1), surface_points(*with_slits, 0.1)
    assert (first.points == second.points).all()
    assert np.isfinite(second.normals).all()


@pytest.mark.parametrize("spacing", [0.0, -1.0, math.nan, math.inf])
def test_spacing_must_be_positive(spacing: float) -> None:
    with pytest.raises(ValueError, match="spacing"):
        surface_points(*surfaces.box((1.0, 1.0, 1.0)), spacing)


def test_a_surface_without_area_is_refused() -> None:
    with pytest.raises(ValueError, match="area"):
        surface_points(np.zeros((3, 3)), np.array([[0, 1, 2]]), 0.1)
