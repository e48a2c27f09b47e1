"""Cracks: whatever corners were moved apart is closed again, without moving a triangle; openings stay open."""

import numpy as np
import pytest
import trimesh

from guidefield.geometry.closed import WIDEST_CRACK, boundary, compact, crack_lids, seams, volume
from guidefield.geometry.solid import solid
from tests.geometry import solids

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
