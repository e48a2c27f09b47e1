import numpy as np
import pytest

from guidefield.geometry import surfaces
from guidefield.geometry.closed import closing_lids, compact


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


def test_a_crack_between_halves_of_an_edge_is_closed() -> None:
    # One side knows a vertex in the middle of an edge, the other doesn't: the lid is a sliver.
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0.5, 0]], float)
    triangles = np.array([[0, 2, 4], [0, 4, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    lids, extent = closing_lids(vertices, triangles)
    assert {frozenset(lid) for lid in lids.tolist()} == {frozenset((1, 2, 4))}
    assert extent == pytest.approx(np.sqrt(2.0))


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
