from __future__ import annotations

import numpy as np
import pytest

from guidefield.geometry.elements import Elements, Pieces, bisect_pieces, blocks, gather_elements
from guidefield.kernels.cover.ball_cover import contained, reaches
from tests.geometry import solids

SEEDS = range(4)


def drawn(seed: int) -> tuple[np.ndarray, Elements]:
    """Balls about a ring, and the elements of its surface."""
    vertices, triangles = mesh = solids.lying(solids.torus(), seed)
    rng = np.random.default_rng(seed)
    elements = gather_elements(bisect_pieces(Pieces(vertices[triangles], np.arange(len(triangles))), 0.008), 0.01)
    centres = solids.on_surface(mesh, 60, rng)[:60] + rng.normal(size=(60, 3)) * 0.01
    return np.column_stack([centres, rng.uniform(0.001, 0.07, 60)]), elements


def inside(balls: np.ndarray, elements: Elements) -> np.ndarray:
    """Which ball contains all corners of which element, by plain distances; shape (n, m)."""
    distances = np.linalg.norm(elements.points - balls[:, None, :3], axis=2)
    farthest = np.maximum.reduceat(distances, elements.first_point[:-1], axis=1)
    return farthest <= balls[:, 3:]


def shared_out(balls: np.ndarray, elements: Elements) -> tuple[np.ndarray, np.ndarray]:
    radii, owners = np.empty(len(balls)), np.empty(len(elements.bounds), np.int64)
    reaches(balls, elements.points, elements.first_point, elements.bounds, blocks(elements), radii, owners)
    return radii, owners


@pytest.mark.parametrize("seed", SEEDS)
def test_an_element_is_contained_if_its_corners_are(seed: int) -> None:
    balls, elements = drawn(seed)
    bits = np.zeros((len(balls), -(-len(elements.bounds) // 64)), np.uint64)
    contained(balls, elements.points, elements.first_point, elements.bounds, blocks(elements), bits)
    found = np.unpackbits(bits.view(np.uint8), axis=1, bitorder="little").astype(bool)
    expected = inside(balls, elements)
    assert expected.any()
    assert (found[:, : len(elements.bounds)] == expected).all()
    assert not found[:, len(elements.bounds) :].any()


@pytest.mark.parametrize("seed", SEEDS)
def test_smaller_balls_contain_the_elements_that_went_to_them(seed: int) -> None:
    balls, elements = drawn(seed)
    radii, owners = shared_out(balls, elements)
    within = inside(balls, elements)
    assert ((owners >= 0) == within.any(axis=0)).all()
    assert (radii <= balls[:, 3]).all()
    smaller = np.column_stack([balls[:, :3], radii * (1.0 + 1e-12)])
    owned = np.flatnonzero(owners >= 0)
    assert inside(smaller, elements)[owners[owned], owned].all()
    assert (radii[np.setdiff1d(np.arange(len(balls)), owners)] == 0.0).all()


@pytest.mark.parametrize("seed", SEEDS)
def test_no_ball_reaches_farther_than_for_what_it_has(seed: int) -> None:
    balls, elements = drawn(seed)
    radii, owners = shared_out(balls, elements)
    distances = np.linalg.norm(elements.points - balls[:, None, :3], axis=2)
    farthest = np.maximum.reduceat(distances, elements.first_point[:-1], axis=1)
    for ball in np.unique(owners[owners >= 0]):
        assert radii[ball] == pytest.approx(farthest[ball, owners == ball].max())
