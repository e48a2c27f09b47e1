"""Closed surfaces: lids on what is missing and on cracks, and faces that cross each other."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings, strategies as st

from guidefield.geometry import closed as module, surfaces
from guidefield.geometry.closed import (
    WIDEST_CRACK,
    boundary,
    closing_lids,
    compact,
    crack_lids,
    crossings,
    seams,
    volume,
)
from guidefield.geometry.mesh_surface import crossing_warnings, join_mesh
from guidefield.geometry.solid import solid
from guidefield.scene.obstacle import build
from tests.geometry import solids
from tests.kernels.evaluation import rigid_motions
from tests.scene.solids import box_mesh, l_prism, mesh_message, moebius, room


@pytest.mark.parametrize("missing", [1, 2, 5, 40, 300])
@pytest.mark.parametrize("seed", [0, 1])
def test_lids_close_whatever_is_missing(missing: int, seed: int) -> None:
    ball = surfaces.sphere(1.0, 3)
    kept = np.sort(
        np.random.default_rng(seed).choice(len(ball.triangles), len(ball.triangles) - missing, replace=False)
    )
    lids, extent = closing_lids(ball.vertices, ball.triangles[kept])
    whole = np.vstack([ball.triangles[kept], lids])
    start, end = whole.ravel(), np.roll(whole, -1, axis=1).ravel()
    for edge in np.unique(np.sort(np.column_stack([start, end]), axis=1), axis=0):
        forward = ((start == edge[0]) & (end == edge[1])).sum()
        assert forward == ((start == edge[1]) & (end == edge[0])).sum()
    assert extent >= 0.1


def test_a_crack_between_halves_of_an_edge_is_closed() -> None:
    # One side knows a vertex in the middle of an edge, the other doesn't: the lid is a sliver.
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0.5, 0]], float)
    triangles = np.array([[0, 2, 4], [0, 4, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    lids, extent = closing_lids(vertices, triangles)
    assert {frozenset(lid) for lid in lids.tolist()} == {frozenset((1, 2, 4))}
    assert extent == pytest.approx(np.sqrt(2.0))


@pytest.mark.parametrize("seed", range(4))
def test_merged_vertices_are_the_distinct_ones(seed: int) -> None:
    rng = np.random.default_rng(seed)
    vertices = np.round(rng.normal(size=(80, 3)), 1) * rng.choice([-1.0, 1.0, 0.0], (80, 3))
    triangles = rng.integers(0, 80, (60, 3))
    found, corners, kept = compact(vertices, triangles)
    distinct, index = np.unique(vertices + 0.0, axis=0, return_inverse=True)
    wanted = index.reshape(-1)[triangles]
    proper = [k for k, corner in enumerate(wanted.tolist()) if len(set(corner)) == 3]
    assert kept.tolist() == proper
    np.testing.assert_array_equal(np.unique(found, axis=0), distinct[np.unique(wanted[proper])])
    assert len(found) == len(np.unique(found, axis=0))
    np.testing.assert_array_equal(found[corners], vertices[triangles[proper]] + 0.0)


Mesh = tuple[np.ndarray, np.ndarray]


def apart(mesh: Mesh, width: float, seed: int = 0) -> Mesh:
    """The same triangles, each with corners of its own, that are up to `width` apart from where they were."""
    vertices, triangles = mesh
    corners = vertices[triangles].reshape(-1, 3)
    moves = np.random.default_rng(seed).uniform(-0.5, 0.5, corners.shape) * width / np.sqrt(3.0)
    return corners + moves, np.arange(len(corners)).reshape(-1, 3)


BODIES = {
    "box": solids.box((0.4, 0.3, 0.2)),
    "hollow": solids.hollow(),
    "channel": solids.channel(),
    "fine": solids.torus(0.1, 0.03, 64, 32),
}


@pytest.mark.parametrize("body", sorted(BODIES))
@pytest.mark.parametrize("width", [1e-9, 1e-5, 9e-4])
def test_corners_that_nearly_coincide_are_closed_by_thin_lids(body: str, width: float) -> None:
    vertices, triangles = apart(BODIES[body], width)
    joined, found = seams(vertices, triangles)
    assert 0.0 < found <= np.sqrt(3.0) * WIDEST_CRACK
    lids = crack_lids(triangles, joined)
    assert not len(boundary(np.concatenate([triangles, lids])))
    assert _least_heights(vertices[lids]).max() <= found * (1.0 + 1e-9)
    closed = volume(vertices, np.concatenate([triangles, lids]))
    area = trimesh.Trimesh(*BODIES[body], process=False).area
    assert closed == pytest.approx(volume(*BODIES[body]), abs=2.0 * width * area)


def _least_heights(corners: np.ndarray) -> np.ndarray:
    """Height of each triangle over its longest edge, shape (n,)."""
    a, b, c = np.moveaxis(corners, 1, 0)
    across = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    longest = np.maximum.reduce([np.linalg.norm(edge, axis=1) for edge in (b - a, c - b, a - c)])
    return across / np.maximum(longest, 1e-300)


def test_the_rim_of_an_opening_is_no_crack_however_fine_it_is() -> None:
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.01)  # edges of 0.4 mm, less than a crack's width
    half = np.array(ball.faces)[ball.triangles_center[:, 2] > 0.0]
    vertices, triangles, _ = compact(np.array(ball.vertices), half)
    assert seams(vertices, triangles)[1] == 0.0


@pytest.mark.parametrize("body", sorted(BODIES))
def test_a_link_in_single_triangles_has_an_inside(body: str) -> None:
    vertices, triangles = BODIES[body]
    whole, cracked = solid(vertices, triangles), solid(*apart((vertices, triangles), 1e-5), widest_gap=0.02)
    assert cracked.closed
    points = solids.in_box_of((vertices, triangles), 200, np.random.default_rng(0))
    np.testing.assert_allclose(cracked.depths(points), whole.depths(points), atol=2e-5)


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
