"""Pseudonormals of meshes whose normals are known."""

from __future__ import annotations

import numpy as np

from guidefield.geometry import surfaces
from guidefield.geometry.surface_rows import write_pseudonormals


def pseudonormals(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    normals = np.empty((len(triangles), 21))
    write_pseudonormals(vertices, triangles, np.arange(len(triangles)), normals)
    return normals


def test_a_cube_has_axes_half_diagonals_and_diagonals() -> None:
    vertices, triangles = surfaces.box((2.0, 2.0, 2.0))
    normals = pseudonormals(vertices, triangles).reshape(len(triangles), 7, 3)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=2), 1.0, atol=1e-12)
    for triangle, parts in zip(vertices[triangles], normals, strict=True):
        face = parts[0]
        assert np.isclose(np.abs(face).max(), 1.0)
        np.testing.assert_allclose(triangle @ face, 1.0)
        for k, corner in enumerate(triangle):
            np.testing.assert_allclose(parts[4 + k], corner / np.sqrt(3.0), atol=1e-12)
            middle = 0.5 * (corner + triangle[(k + 1) % 3])
            # an edge of the cube, or a diagonal of one of its faces
            outward = np.where(np.isclose(np.abs(middle), 1.0), middle, 0.0)
            np.testing.assert_allclose(parts[1 + k], outward / np.linalg.norm(outward), atol=1e-12)


def test_on_a_round_ball_they_are_radial() -> None:
    vertices, triangles = surfaces.sphere(0.5)
    normals = pseudonormals(vertices, triangles).reshape(len(triangles), 7, 3)
    corners = vertices[triangles]
    radial = corners / np.linalg.norm(corners, axis=2, keepdims=True)
    assert (np.einsum("tki,tki->tk", normals[:, 4:], radial) > 0.99).all()


def test_normals_of_a_doubled_sheet_cancel() -> None:
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    normals = pseudonormals(vertices, np.array([[0, 1, 2], [0, 2, 1]])).reshape(2, 7, 3)
    np.testing.assert_allclose(normals[:, 0], [[0, 0, 1], [0, 0, -1]])
    np.testing.assert_allclose(normals[:, 1:], 0.0)
