"""Solids from the cache are those that are built, once."""

from __future__ import annotations

import numpy as np

from guidefield.geometry.solid_cache import clear_solids, fill_solid_of_mesh, solid_of_mesh
from tests.geometry import solids


def test_a_mesh_has_one_solid_until_the_cache_is_cleared() -> None:
    vertices, triangles = solids.hollow()
    first = solid_of_mesh(vertices, triangles, 0.0)
    assert solid_of_mesh(vertices.copy(), triangles.copy(), 0.0) is first
    assert solid_of_mesh(vertices, triangles, 0.02) is first  # it is closed without gaps
    full = fill_solid_of_mesh(vertices, triangles, 0.02)
    assert fill_solid_of_mesh(vertices, triangles, 0.02) is full
    middle = np.zeros((1, 3))
    assert full.depths(middle)[0] > first.depths(middle)[0]
    assert solid_of_mesh(vertices, triangles[1:], 0.0) is not first
    clear_solids()
    assert solid_of_mesh(vertices, triangles, 0.0) is not first


def test_an_open_mesh_with_gaps_closed_is_another_solid() -> None:
    vertices, triangles = solids.cracked()
    assert not solid_of_mesh(vertices, triangles, 0.0).closed
    assert solid_of_mesh(vertices, triangles, 0.02).closed
