"""What a mesh bounds, against trimesh and by hand."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings, strategies as st

from guidefield.geometry.closed import find_connected, volume
from guidefield.geometry.mesh_surface import _CHUNK, _is_dented, mesh_surface
from tests.scene.solids import box_mesh, klein_bottle, l_prism, moebius, room


def soup(vertices, triangles):
    """The same triangles, none sharing a vertex with another."""
    return vertices[triangles].reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3)


@settings(max_examples=15)
@given(st.integers(0, 10**6), st.integers(4, 60))
def test_a_hull_is_convex_and_solid(seed, count):
    points = np.random.default_rng(seed).normal(size=(count, 3)) * [1.0, 0.5, 2.0]
    hull = trimesh.convex.convex_hull(points)
    surface = mesh_surface(np.array(hull.vertices), np.array(hull.faces))
    assert surface.solid
    assert surface.warnings == ()
    assert surface.hull.computeVolume() == pytest.approx(hull.volume, rel=1e-9)
    assert volume(surface.vertices, surface.triangles) == pytest.approx(hull.volume, rel=1e-9)


@pytest.mark.parametrize("dented", [0, -1])
def test_a_dent_anywhere_in_a_large_mesh_is_found(dented):
    sphere = trimesh.creation.icosphere(subdivisions=5, radius=0.5)
    vertices, faces = np.array(sphere.vertices), np.array(sphere.faces)
    assert len(faces) > 4 * _CHUNK
    assert not _is_dented(vertices, faces, 1e-7)
    vertices[faces[dented, 0]] *= 0.999
    assert _is_dented(vertices, faces, 1e-7)


@pytest.mark.parametrize("width", [1e-9, 1e-5, 9e-4])
@pytest.mark.parametrize(("mesh", "expected"), [(box_mesh(), 1.0), (l_prism(), 3.0), (room(2.0, 1.0), 7.0)])
def test_cracks_are_closed_and_told(width, mesh, expected):
    vertices, triangles = soup(*mesh)
    moves = np.random.default_rng(0).uniform(-0.5, 0.5, vertices.shape) * width / np.sqrt(3.0)
    surface = mesh_surface(vertices + moves, triangles)
    assert surface.solid
    assert volume(surface.vertices, surface.triangles) == pytest.approx(expected, abs=20.0 * width)
    assert "cracks" in surface.warnings[-1]
    given = {tuple(map(tuple, corners)) for corners in (vertices + moves + 0.0)[triangles].round(12)}
    kept = {tuple(map(tuple, corners)) for corners in surface.vertices[surface.triangles].round(12)}
    assert given <= kept  # nothing is moved


def test_cracks_and_triangles_that_face_inwards_are_mended_together():
    vertices, triangles = soup(*l_prism())
    vertices += np.random.default_rng(0).uniform(-1e-5, 1e-5, vertices.shape)
    triangles[::3] = triangles[::3, ::-1]
    surface = mesh_surface(vertices, triangles)
    assert surface.solid
    assert volume(surface.vertices, surface.triangles) == pytest.approx(3.0, abs=1e-3)
    assert "faced inwards" in surface.warnings[0]
    assert "cracks" in surface.warnings[1]


def test_an_open_mesh_is_a_thin_wall():
    vertices, triangles = box_mesh()
    surface = mesh_surface(vertices, triangles[:-2])
    assert not surface.solid
    assert surface.hull is None
    assert "open (4 edges" in surface.warnings[0]


@settings(max_examples=15)
@given(st.integers(1, 2**20 - 2))
def test_triangles_that_face_inwards_are_turned(mask):
    vertices, triangles = l_prism()
    flipped = np.array([bool(mask >> i & 1) for i in range(len(triangles))])
    triangles[flipped] = triangles[flipped][:, ::-1]
    surface = mesh_surface(vertices, triangles)
    assert surface.solid
    assert volume(surface.vertices, surface.triangles) == pytest.approx(3.0)
    assert surface.warnings
    assert trimesh.Trimesh(surface.vertices, surface.triangles).is_volume


def test_a_hollow_stays_hollow():
    surface = mesh_surface(*room(2.0, 1.0))
    assert surface.solid
    assert surface.hull is None
    assert volume(surface.vertices, surface.triangles) == pytest.approx(7.0)


@pytest.mark.parametrize("mesh", [moebius(), klein_bottle()])
def test_a_surface_with_one_side_is_a_thin_wall(mesh):
    surface = mesh_surface(*mesh)
    assert not surface.solid
    assert surface.warnings


@settings(max_examples=18)
@given(st.integers(0, 10**6))
def test_pieces_are_those_of_a_graph_search(seed):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(3, 40))
    triangles = rng.integers(0, count, (int(rng.integers(1, 25)), 3))
    labels = find_connected(count, triangles)
    neighbours = {v: set() for v in range(count)}
    for triangle in triangles.tolist():
        for v in triangle:
            neighbours[v] |= set(triangle)
    for root in range(count):
        reached, waiting = {root}, [root]
        while waiting:
            for there in neighbours[waiting.pop()] - reached:
                reached.add(there)
                waiting.append(there)
        assert labels[root] == min(reached)
