"""Faces that cross each other: by hand, against trimesh's bodies, and as laws."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings, strategies as st

from guidefield.geometry import closed as module
from guidefield.geometry.closed import crossings
from guidefield.geometry.mesh_surface import crossing_warnings, join_mesh
from guidefield.scene.obstacle import build
from tests.kernels.evaluation import rigid_motions
from tests.scene.solids import box_mesh, l_prism, mesh_message, moebius, room


def two_cubes(shift, size=1.0):
    vertices, triangles = box_mesh()
    return np.vstack([vertices, size * vertices + shift]), np.vstack([triangles, triangles + 8])


def crosses_by_edges(one, other):
    """Whether an edge of either goes through the inside of the other, each by solving for where."""
    for edges, face in ((one, other), (other, one)):
        for start, end in zip(edges, np.roll(edges, -1, axis=0), strict=True):
            system = np.column_stack([end - start, face[0] - face[1], face[0] - face[2]])
            if abs(np.linalg.det(system)) < 1e-12:  # beside the face, or within its plane
                continue
            t, u, v = np.linalg.solve(system, face[0] - start)
            if 0.0 < t < 1.0 and u > 0.0 and v > 0.0 and u + v < 1.0:
                return True
    return False


@settings(max_examples=12)
@given(st.integers(0, 10**6), rigid_motions(), st.integers(1, 12))
def test_random_faces_cross_where_edges_go_through_wherever_they_stand(seed, motion, in_slab):
    with pytest.MonkeyPatch.context() as patch:  # slabs that are swept, and chunks of pairs, of a few faces
        patch.setattr(module, "_IN_SLAB", in_slab)
        patch.setattr(module, "_CHUNK", 5)
        check_random_faces(seed, motion)


def check_random_faces(seed, motion):
    rng = np.random.default_rng(seed)
    corners = rng.normal(size=(12, 1, 3)) + rng.normal(size=(12, 3, 3))
    expected = {(i, j) for j in range(12) for i in range(j) if crosses_by_edges(corners[i], corners[j])}
    vertices, triangles = corners.reshape(-1, 3), np.arange(36).reshape(-1, 3)
    assert set(map(tuple, crossings(vertices, triangles).pairs.tolist())) == expected
    rotation, translation = motion
    moved = crossings(vertices @ rotation.T + translation, triangles)
    assert moved.complete
    assert set(map(tuple, moved.pairs.tolist())) == expected
    order, names = rng.permutation(12), rng.permutation(36)
    renamed = np.empty_like(vertices)
    renamed[names] = vertices
    shuffled = crossings(renamed, np.roll(names[triangles], 1, axis=1)[order]).pairs
    assert {tuple(sorted(pair)) for pair in order[shuffled].tolist()} == expected


def test_no_faces_cross_where_all_are_joined_to_points():
    found = crossings(np.zeros((3, 3)), np.empty((0, 3), np.int64))
    assert found.complete
    assert found.pairs.shape == (0, 2)


def test_a_sheet_through_itself_names_its_faces_as_they_were_sent():
    vertices = np.array([[0, 0, 0], [2, 0, 0], [0, 2, 0], [0.5, 0.3, -1], [0.4, 0.5, 1]], float)
    triangles = np.array([[0, 0, 1], [0, 1, 2], [1, 1, 2], [0, 3, 4]])
    faults = crossing_warnings(join_mesh(vertices, triangles))
    assert faults == ("it intersects itself: 1 pair of its triangles cross, such as 1 and 3",)
    assert any(faults[0] in warning for warning in build(mesh_message(vertices, triangles), 0).warnings)


@pytest.mark.parametrize(
    "mesh",
    [
        (np.array(one.vertices), np.array(one.faces))
        for one in (
            trimesh.creation.icosphere(subdivisions=3),
            trimesh.creation.uv_sphere(count=[40, 40]),
            trimesh.creation.torus(1.0, 0.3),
            trimesh.creation.capsule(),
        )
    ]
    + [l_prism(), room(2.0, 1.0), moebius()],
)
def test_clean_meshes_do_not_cross(mesh):
    vertices, triangles = mesh
    rotation = trimesh.transformations.random_rotation_matrix(np.array([0.2, 0.5, 0.7]))[:3, :3]
    assert crossing_warnings(join_mesh(vertices, triangles)) == ()
    assert crossing_warnings(join_mesh(1e-3 * vertices @ rotation.T + [5.0, -3.0, 1.0], triangles)) == ()


@pytest.mark.parametrize("limit", ["SWEPT", "EXAMINED"])
def test_what_is_too_large_is_told(monkeypatch, limit):
    monkeypatch.setattr(module, limit, 20)
    found = crossings(*two_cubes([0.3, 0.4, 0.45]))
    assert not found.complete
    assert "too large" in crossing_warnings(join_mesh(*two_cubes([0.3, 0.4, 0.45])))[-1]
