"""A sweep finds the pairs of triangles that may cross, each once, and none that crosses is left out."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.geometry import crossings as module
from guidefield.geometry.crossings import crossings
from guidefield.kernels.cover.merge_points import write_planes


@settings(deadline=None, max_examples=12)
@given(st.integers(2, 60), st.integers(1, 9), st.integers(0, 10**6))
def test_the_pairs_are_those_of_all_compared(count: int, slabs: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    corners = rng.normal(size=(count, 1, 3)) + rng.uniform(0.1, 1.5) * rng.normal(size=(count, 3, 3))
    vertices, triangles = corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)
    every = np.array([(i, j) for j in range(count) for i in range(j)])
    expected = every[module._cross(vertices - vertices.mean(axis=0), triangles, every, 1e-9)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "_IN_SLAB", -(-count // slabs))
        patch.setattr(module, "_CHUNK", 50)
        found = crossings(vertices, triangles)
    assert found.complete
    assert found.pairs.tolist() == sorted(expected.tolist())


def test_planes_say_how_high_corners_are() -> None:
    rng = np.random.default_rng(1)
    vertices, triangles = rng.normal(size=(30, 3)), rng.permutation(30).reshape(-1, 3)
    triangles[-1] = triangles[-1][0]  # no area
    corners, planes = np.empty((10, 9)), np.empty((10, 5))
    write_planes(vertices, triangles, 1e-6, corners, planes)
    np.testing.assert_array_equal(corners.reshape(-1, 3, 3), vertices[triangles])
    a, b, c = corners[:-1].reshape(-1, 3, 3).swapaxes(0, 1)
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    np.testing.assert_allclose(planes[:-1, :3], normals, atol=1e-12)
    np.testing.assert_allclose(planes[:-1, 3], (normals * a).sum(axis=1), atol=1e-12)
    assert (planes[-1, :4] == 0.0).all()
    assert (planes[:, 4] >= 0.5e-6).all()
