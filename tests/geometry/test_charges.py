import math

import numpy as np
import pytest

from guidefield.geometry import surfaces
from guidefield.geometry.surfaces import Surface
from guidefield.robot.link_charges import surface_points
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
