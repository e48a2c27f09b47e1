"""What a mesh bounds, its facets, and the boxes and quadrilaterals that meshes are made of."""

from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest
import trimesh
from hypothesis import given, settings, strategies as st

from guidefield.collision.narrow_phase import NarrowPhase, transform
from guidefield.geometry.charged import field_tables, pair_faces
from guidefield.geometry.closed import find_connected, volume
from guidefield.geometry.mesh_surface import _CHUNK, _is_dented, find_boxes, mesh_surface
from guidefield.geometry.surfaces import se3
from guidefield.kernels.distance.distance import BOX, SOLID, distance_at_points
from guidefield.kernels.field.field import field_at_points
from guidefield.messages import scene as messages
from guidefield.scene import obstacle_parts
from guidefield.scene.distance_tables import distance_tables
from guidefield.scene.obstacle_parts import Patches
from guidefield.scene.scene import build
from tests.geometry import solids
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


def terrain(side: int) -> tuple[np.ndarray, np.ndarray]:
    """An open surface of 2 side^2 triangles, 2 m wide."""
    x, y = (axis.ravel() for axis in np.meshgrid(*2 * [np.linspace(-1.0, 1.0, side + 1)], indexing="ij"))
    corner = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).ravel()
    first = np.column_stack([corner, corner + side + 1, corner + 1])
    second = np.column_stack([corner + 1, corner + side + 1, corner + side + 2])
    return np.column_stack([x, y, 0.2 * np.sin(5.0 * x) * np.cos(4.0 * y)]), np.concatenate([first, second])


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Patches of few triangles."""
    monkeypatch.setattr(obstacle_parts, "PATCH", 50)


def _placement(rng: np.random.Generator) -> Any:
    return se3(rng.uniform(-1.0, 1.0, 3).tolist(), rng.normal(size=4).tolist())


@pytest.mark.usefixtures("small")
def test_a_surface_in_patches_is_judged_as_in_one_piece() -> None:
    vertices, triangles = terrain(20)
    body, whole, patches = (
        coal.Capsule(0.05, 0.3),
        obstacle_parts.bvh(vertices, triangles),
        Patches(lambda: (vertices, triangles)),
    )
    rng = np.random.default_rng(4)
    there = _placement(rng)
    touching = 0
    for _ in range(60):
        here = there * _placement(rng)
        here.translation = there.act(rng.uniform([-1.3, -1.3, -0.4], [1.3, 1.3, 0.6]))
        asked = [
            NarrowPhase(lambda b, o=other: (body, o)[b], lambda b, h=here: transform((h, there)[b]))
            for other in (whole, patches)
        ]
        apart, ours = (phase.distance(0, 1).distance for phase in asked)
        assert max(ours, 0.0) == pytest.approx(max(apart, 0.0), abs=1e-7)
        touching += apart <= 0.0
        for margin in (0.0, 0.07):
            one, other = (phase.penetration(0, 1, margin) for phase in asked)
            assert (one is None) == (other is None)
            if one is not None and other is not None and apart > 0.0:
                assert other >= apart - 1e-6
    assert 5 < touching < 55


SIZES = ((0.3, 0.2, 0.1), (0.2, 0.2, 0.2), (2.0, 1e-3, 0.5), (1e-2, 30.0, 1e-2))


def placed(mesh: solids.Mesh, rng: np.random.Generator, far: float = 1.0) -> solids.Mesh:
    """A mesh turned and moved anywhere."""
    rotation = pin.Quaternion(*rng.normal(size=4)).normalized().matrix()
    return mesh[0] @ rotation.T + far * rng.normal(size=3), mesh[1]


@pytest.mark.parametrize("size", SIZES)
def test_a_box_is_found_however_it_stands(size: tuple[float, float, float]) -> None:
    rng = np.random.default_rng(3)
    for _ in range(10):
        vertices, triangles = placed(solids.box(size), rng)
        (found,) = find_boxes(vertices, [triangles[rng.permutation(12)]])
        assert np.allclose(np.sort(2.0 * found.halves), np.sort(size), rtol=1e-9)
        own = (vertices - found.centre) @ found.rotation
        assert (np.abs(own) <= found.halves + 1e-12).all()
        assert np.linalg.det(found.rotation) == pytest.approx(1.0)


def test_what_has_eight_corners_and_is_no_box_is_none() -> None:
    vertices, triangles = solids.box((0.3, 0.2, 0.1))
    for change in ("corner", "sheared", "tapered", "dented"):
        changed = vertices.copy()
        if change == "corner":
            changed[0, 0] += 1e-5
        elif change == "sheared":
            changed[:, 0] += 0.01 * changed[:, 1]
        elif change == "tapered":
            changed[changed[:, 2] > 0.0, :2] *= 0.9
        else:
            changed[0] = 0.0
        assert find_boxes(changed, [triangles]) == [None], change


def test_distances_from_a_mesh_of_boxes_are_those_from_the_boxes() -> None:
    rng = np.random.default_rng(5)
    meshes = [placed(solids.box(size), rng, 0.4) for size in SIZES[:2]]
    wedge = solids.box((0.2, 0.1, 0.3))
    wedge[0][wedge[0][:, 2] > 0.0, 0] *= 0.5
    vertices, triangles = solids.together(*meshes, placed(wedge, rng, 0.4))
    named = {"vertices": vertices.tolist(), "triangles": triangles.tolist()}
    one = distance_tables(build(messages.Scene(name="one", obstacles=[messages.Mesh(name="all", **named)])))
    each = [
        messages.Mesh(name=f"{k}", vertices=some.tolist(), triangles=faces.tolist())
        for k, (some, faces) in enumerate([*meshes, (vertices[16:], triangles[24:] - 16)])
    ]
    several = distance_tables(build(messages.Scene(name="several", obstacles=each)))
    assert sorted(one.kinds) == sorted(several.kinds) == [BOX, BOX, SOLID]
    points = rng.uniform(-1.0, 1.0, (500, 3))
    found, expected = distance_at_points(one, points), distance_at_points(several, points)
    assert np.allclose(found[0], expected[0], atol=1e-12)


@pytest.mark.parametrize("shape", ["box", "channel", "torus"])
def test_the_field_of_paired_faces_is_that_of_the_triangles(shape: str) -> None:
    rng = np.random.default_rng(11)
    mesh = {"box": solids.box((0.3, 0.2, 0.1)), "channel": solids.channel(), "torus": solids.torus()}[shape]
    vertices, triangles = placed(mesh, rng)
    quads, rest = pair_faces(vertices, triangles)
    assert 2 * len(quads) + len(rest) == len(triangles)
    assert len(quads) >= {"box": 6, "channel": 12, "torus": 0}[shape]
    points = vertices.mean(axis=0) + rng.normal(scale=0.3, size=(200, 3))
    paired = field_at_points(field_tables(rest, quads=quads), points)
    expected = field_at_points(field_tables(vertices[triangles]), points)
    for value, other in zip(paired, expected, strict=True):
        assert np.allclose(value, other, rtol=1e-9, atol=1e-9)
