"""Solids from the cache are those that are built, once."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from guidefield.geometry.solid import Solid, solid
from guidefield.geometry.solid_cache import SolidCache, clear_solids, filled_solid_of_mesh, solid_of_mesh
from tests.geometry import solids


def test_a_mesh_has_one_solid_until_the_cache_is_cleared() -> None:
    vertices, triangles = solids.hollow()
    first = solid_of_mesh(vertices, triangles, 0.0)
    assert solid_of_mesh(vertices.copy(), triangles.copy(), 0.0) is first
    assert solid_of_mesh(vertices, triangles, 0.02) is first  # it is closed without gaps
    full = filled_solid_of_mesh(vertices, triangles, 0.02)
    assert filled_solid_of_mesh(vertices, triangles, 0.02) is full
    middle = np.zeros((1, 3))
    assert full.depths(middle)[0] > first.depths(middle)[0]
    assert solid_of_mesh(vertices, triangles[1:], 0.0) is not first
    clear_solids()
    assert solid_of_mesh(vertices, triangles, 0.0) is not first


def test_an_open_mesh_with_gaps_closed_is_another_solid() -> None:
    vertices, triangles = solids.cracked()
    assert not solid_of_mesh(vertices, triangles, 0.0).closed
    assert solid_of_mesh(vertices, triangles, 0.02).closed


def test_threads_that_ask_at_once_get_one_solid_and_what_fails_is_tried_again() -> None:
    cache, built, begun = SolidCache(10**6), [], threading.Barrier(4)

    def build() -> Solid:
        built.append(solid(*solids.torus()))
        return built[-1]

    def ask() -> Solid:
        begun.wait()
        return cache.find(("ring",), build)

    def fail() -> Solid:
        raise ValueError("flat")

    with pytest.raises(ValueError, match="flat"):
        cache.find(("ring",), fail)
    with ThreadPoolExecutor(4) as pool:
        found = [one.result() for one in [pool.submit(ask) for _ in range(4)]]
    assert len(built) == 1
    assert all(one is built[0] for one in found)


def test_those_used_longest_ago_go_first() -> None:
    made = solid(*solids.torus())
    cache = SolidCache(2 * len(made.owners))
    for key in (("a",), ("b",), ("a",), ("c",)):
        cache.find(key, lambda: made)
    assert cache.peek(("b",)) is None
    assert cache.peek(("a",)) is cache.peek(("c",)) is made
