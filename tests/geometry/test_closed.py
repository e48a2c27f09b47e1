from __future__ import annotations

import numpy as np
import pytest

from guidefield.geometry import surfaces
from guidefield.geometry.closed import closing_lids, compact, find_connected, volume
from guidefield.geometry.surfaces import Surface
from tests.geometry import solids
from tests.geometry.measures import is_closed


def test_vertices_at_the_same_place_become_one() -> None:
    vertices, triangles = solids.box((1.0, 2.0, 3.0))
    soup = vertices[triangles].reshape(-1, 3)
    soup[0] += 0.0 * soup[0] - 0.0
    merged, corners, given = compact(soup, np.arange(len(soup)).reshape(-1, 3))
    assert len(merged) == 8
    assert is_closed(Surface(merged, corners))
    assert (given == np.arange(12)).all()
    assert (merged[corners] == vertices[triangles]).all()


def test_what_has_a_vertex_twice_is_left_out() -> None:
    vertices, triangles = solids.box((1.0, 1.0, 1.0))
    with_slits = np.vstack([[[0, 0, 1]], triangles, [[3, 3, 3]]])
    merged, corners, given = compact(np.vstack([vertices, [[9, 9, 9]]]), with_slits)
    assert (given == np.arange(1, 13)).all()
    assert (merged[corners] == vertices[triangles]).all()
    assert merged.max() < 1.0  # the vertex that no triangle uses is gone


def test_vertices_must_be_finite() -> None:
    with pytest.raises(ValueError, match="finite"):
        compact(np.array([[0, 0, 0], [1, 0, 0], [0, np.nan, 0]]), np.array([[0, 1, 2]]))


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


def test_a_closed_surface_needs_none_and_a_gap_has_its_extent() -> None:
    vertices, triangles = solids.box((1.0, 2.0, 3.0))
    lids, extent = closing_lids(vertices, triangles)
    assert len(lids) == 0
    assert extent == 0.0
    lids, extent = closing_lids(vertices, triangles[2:])  # without the face at -x
    assert len(lids) == 2
    assert extent == pytest.approx(np.hypot(2.0, 3.0))
    assert volume(vertices, np.vstack([triangles[2:], lids])) == pytest.approx(6.0)


def test_a_crack_between_halves_of_an_edge_is_closed() -> None:
    # One side knows a vertex in the middle of an edge, the other doesn't: the lid is a sliver.
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0.5, 0]], float)
    triangles = np.array([[0, 2, 4], [0, 4, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    lids, extent = closing_lids(vertices, triangles)
    assert {frozenset(lid) for lid in lids.tolist()} == {frozenset((1, 2, 4))}
    assert extent == pytest.approx(np.sqrt(2.0))


def test_pieces_are_told_apart() -> None:
    vertices, triangles = solids.together(solids.torus(), solids.box((1, 1, 1)), solids.channel())
    labels = find_connected(len(vertices), triangles)
    counts = [len(solids.torus()[0]), 8, len(solids.channel()[0])]
    assert labels.tolist() == [
        first for first, n in zip(np.cumsum([0, *counts]), counts, strict=False) for _ in range(n)
    ]


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
