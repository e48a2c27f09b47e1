import numpy as np
import pytest

from guidefield.geometry.solid import solid
from guidefield.kernels.distance.ray_winding import ray_direction, ray_winding
from tests.geometry import solids
from tests.kernels.parts import from_python

direction_of_ray = from_python(ray_direction)

BODIES = {
    "ring": solids.torus(),
    "channel": solids.channel(),
    "hollow": solids.hollow(),
    "overlapping": solids.overlapping(),
    "turned": solids.lying(solids.torus(), 3),
}


def windings(points: np.ndarray, mesh: solids.Mesh) -> np.ndarray:
    """Sum over the solids that a mesh is of."""
    body = solid(*mesh)
    spans = [tuple(span) for span in body.spans.tolist()]
    return np.array([sum(ray_winding(*point, body.tables, span) for span in spans) for point in points])


@pytest.mark.parametrize("mesh", BODIES.values(), ids=BODIES)
def test_agrees_with_the_solid_angle(mesh: solids.Mesh) -> None:
    points = solids.in_box_of(mesh, 800, np.random.default_rng(0))
    assert (windings(points, mesh) == np.rint(solids.winding(points, mesh))).all()


@pytest.mark.parametrize("mesh", BODIES.values(), ids=BODIES)
def test_next_to_the_surface_too(mesh: solids.Mesh) -> None:
    rng = np.random.default_rng(1)
    points = solids.on_surface(mesh, 200, rng)
    points = points + 1e-7 * rng.normal(size=points.shape)
    points = points[solids.distance(points, mesh) > 1e-9]
    assert (windings(points, mesh) == np.rint(solids.winding(points, mesh))).all()


def test_where_rays_meet_edges_and_corners() -> None:
    # Points from which very many edges lie in the same directions: those of a grid within a box of 12 triangles.
    mesh = solids.box((1.0, 1.0, 1.0))
    axis = np.linspace(-0.45, 0.45, 7)
    points = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)
    assert (windings(points, mesh) == 1).all()
    assert (windings(points + np.array([1.0, 0.0, 0.0]), mesh) == 0).all()


@pytest.mark.parametrize("seed", range(3))
def test_a_ray_through_a_corner_or_an_edge_is_not_believed(seed: int) -> None:
    vertices, triangles = mesh = solids.lying(solids.torus(around=8, across=6), seed)
    middles = vertices[triangles[:, :2]].mean(axis=1)
    for k in range(2):
        direction = np.array(direction_of_ray(k))
        points = np.vstack([vertices, middles]) - 0.02 * direction
        points = points[solids.distance(points, mesh) > 1e-6]
        assert (windings(points, mesh) == np.rint(solids.winding(points, mesh))).all()
