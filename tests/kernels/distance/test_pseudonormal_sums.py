"""Pseudonormals against sums over a list of neighbours, face by face."""

from __future__ import annotations

import numpy as np
import pytest

from guidefield.geometry.surface_rows import write_pseudonormals


def unit(vector: np.ndarray) -> np.ndarray:
    """A vector of length 1; of one that is rounding, nothing."""
    length = float(np.linalg.norm(vector))
    return vector / length if length > 1e-12 else np.zeros(3)


def summed(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """The same, by going through all faces for each part."""
    faces = [unit(np.cross(b - a, c - a)) for a, b, c in vertices[triangles]]
    found = np.empty((len(triangles), 7, 3))
    for t, corners in enumerate(triangles.tolist()):
        found[t, 0] = faces[t]
        for k in range(3):
            edge = {corners[k], corners[(k + 1) % 3]}
            around = [face for face, other in zip(faces, triangles.tolist(), strict=True) if edge <= set(other)]
            found[t, 1 + k] = unit(np.sum(around, axis=0))
            total = np.zeros(3)
            for face, other in zip(faces, triangles.tolist(), strict=True):
                if corners[k] in other:
                    at = other.index(corners[k])
                    here, after, before = vertices[[other[at], other[(at + 1) % 3], other[(at + 2) % 3]]]
                    total += face * np.arccos(np.clip(unit(after - here) @ unit(before - here), -1.0, 1.0))
            found[t, 4 + k] = unit(total)
    return found.reshape(len(triangles), 21)


@pytest.mark.parametrize("seed", range(5))
def test_sums_are_those_over_neighbours(seed: int) -> None:
    rng = np.random.default_rng(seed)
    vertices = rng.normal(size=(12, 3))
    triangles = np.array([rng.permutation(12)[:3] for _ in range(25)])
    found = np.empty((25, 21))
    write_pseudonormals(vertices, triangles, np.arange(25), found)
    np.testing.assert_allclose(found, summed(vertices, triangles), atol=1e-9)
