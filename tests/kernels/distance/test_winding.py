"""Winding numbers by rays and by crossings against solid angles, of closed surfaces and at points that are odd."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings, strategies as st

from guidefield.geometry.solid import solid
from guidefield.kernels.distance import winding
from guidefield.kernels.distance.winding import (
    RUN,
    UNSURE,
    find_run_boxes,
    ray_direction,
    ray_winding,
    winding_by_angles,
    winding_by_crossings,
)
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


def boxes_of(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    boxes = np.empty((-(-len(triangles) // RUN), 4))
    find_run_boxes(vertices, triangles, boxes)
    return boxes


def both(meshes: list[trimesh.Trimesh]) -> trimesh.Trimesh:
    return trimesh.util.concatenate(meshes)


def turned_inside_out(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices, mesh.faces[:, ::-1], process=False)


BALL, BOX = trimesh.creation.icosphere(3), trimesh.creation.box((1.0, 1.0, 1.0))
RING = trimesh.creation.torus(1.0, 0.3, major_sections=96, minor_sections=48)
MESHES = {
    "box": BOX,
    "ball": BALL,
    "ring": RING,
    "hollow": both([BALL, turned_inside_out(trimesh.creation.icosphere(3, 0.7))]),
    "thin shell": both([BALL, turned_inside_out(trimesh.creation.icosphere(3, 1.0 - 1e-6))]),
    "in one another": both([BALL, trimesh.creation.icosphere(2, 0.5)]),
    "overlapping": both([BOX, BOX.copy().apply_translation((0.5, 0.25, 0.125))]),
    "side by side": both([BOX, BOX.copy().apply_translation((1.0, 0.0, 0.0))]),
    "inside out": turned_inside_out(RING),
    "needle": trimesh.creation.cylinder(1e-3, 2.0, sections=64),
    "slivers": trimesh.Trimesh(
        np.vstack([BOX.vertices, BOX.vertices[0]]), np.vstack([BOX.faces, [[0, 8, 1], [1, 8, 0]]]), process=False
    ),
}


def points_about(mesh: trimesh.Trimesh, scale: float, rng: np.random.Generator) -> np.ndarray:
    """Random ones, and those on whose line are corners, middles of edges and of triangles."""
    low, high = mesh.bounds
    anywhere = rng.uniform(low - 0.1 * scale, high + 0.1 * scale, (20, 3))
    edges = mesh.vertices[rng.permutation(mesh.edges)[:6]].mean(axis=1)
    on = np.concatenate([rng.permutation(mesh.vertices)[:6], rng.permutation(mesh.triangles_center)[:6], edges])
    far = scale * rng.choice([-1.0, 1.0], len(on)) * rng.uniform(1e-6, 1.0, len(on))
    line = np.array([winding._ALONG_X, winding._ALONG_Y, 1.0])
    return np.concatenate([anywhere, on + far[:, None] * line, on + scale * rng.normal(size=on.shape) * 1e-3])


@settings(max_examples=18)
@given(st.sampled_from(sorted(MESHES)), st.integers(0, 10**6), st.sampled_from([1e-3, 1.0, 1e4]))
def test_what_is_sure_is_what_solid_angles_say(name: str, seed: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    turn = trimesh.transformations.random_rotation_matrix(rng.random(3)) if seed % 2 else np.eye(4)
    mesh = MESHES[name].copy().apply_transform(turn).apply_scale(scale)
    mesh.apply_translation(scale * rng.normal(size=3) * (seed % 3))
    vertices, triangles = np.ascontiguousarray(mesh.vertices, float), np.ascontiguousarray(mesh.faces, np.int64)
    boxes, sure, points = boxes_of(vertices, triangles), 0, points_about(mesh, scale, rng)
    for point in points.tolist():
        turns = winding_by_crossings(*point, vertices, triangles, boxes)
        exact = winding_by_angles(*point, vertices, triangles)
        if turns != UNSURE and abs(exact - round(exact)) < 1e-3:
            assert turns == round(exact)
            sure += 1
    assert sure >= 0.6 * len(points)
