"""Triangles clipped at planes keep their area and stay on their side; corners of cells are within the body."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.spatial
from hypothesis import given, settings, strategies as st

from guidefield.geometry import surfaces
from guidefield.geometry.decomposition import clip_at, corners_of_cell
from guidefield.geometry.elements import Pieces
from guidefield.geometry.solid import solid
from tests.geometry import solids


@settings(deadline=None, max_examples=12)
@given(st.integers(0, 10**6))
def test_both_sides_make_the_whole(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pieces = Pieces(rng.normal(size=(30, 3, 3)), np.arange(30))
    normal = rng.normal(size=3)
    plane = np.append(normal / np.linalg.norm(normal), rng.normal(scale=0.5))
    below, above = clip_at(pieces, plane), clip_at(pieces, -plane)
    assert below.area + above.area == pytest.approx(pieces.area)
    assert (below.corners @ plane[:3] <= plane[3] + 1e-12).all()
    assert (above.corners @ plane[:3] >= plane[3] - 1e-12).all()
    for part in (below, above):
        for corners, source in zip(part.corners, part.sources, strict=True):
            a, b, c = pieces.corners[source]
            shares = np.linalg.lstsq(np.column_stack([a, b, c]), corners.T, rcond=None)[0]
            assert np.column_stack([a, b, c]) @ shares == pytest.approx(corners.T)
            assert shares.min() >= -1e-9
            assert shares.sum(axis=0) == pytest.approx(1.0)


@pytest.mark.parametrize("seed", range(5))
def test_neighbours_are_cut_at_the_same_points(seed: int) -> None:
    rng = np.random.default_rng(seed)
    corners = surfaces.sphere(1.0).corners
    whole = Pieces(corners, np.arange(len(corners)))
    for _ in range(3):
        normal = rng.normal(size=3)
        plane = np.append(normal / np.linalg.norm(normal), 0.3 * rng.normal())
        whole = clip_at(whole, plane)
    points = np.unique(whole.corners.reshape(-1, 3), axis=0)
    distances = scipy.spatial.cKDTree(points).query(points, k=2)[0][:, 1]
    assert distances.min() > 1e-9  # nothing is doubled but for rounding


def test_corners_of_a_cell_are_those_within_the_body() -> None:
    body = solid(*solids.box((2.0, 2.0, 2.0)))
    near = np.array([[1.0, 0, 0, 0.5], [0, 1.0, 0, 0.5], [0, 0, 1.0, 0.5]])
    assert corners_of_cell(body, near) == pytest.approx(np.array([[0.5, 0.5, 0.5]]))
    assert corners_of_cell(body, near[:2]).shape == (0, 3)
    far = near * [1.0, 1.0, 1.0, 4.0]
    assert corners_of_cell(body, far).shape == (0, 3)
    opposite = np.vstack([near, [[-1.0, 0, 0, 0.5]]])
    assert len(corners_of_cell(body, opposite)) == 2
    cut_off = np.vstack([near, [[1.0, 0, 0, 0.4]]])
    assert corners_of_cell(body, cut_off) == pytest.approx(np.array([[0.4, 0.5, 0.5]]))
