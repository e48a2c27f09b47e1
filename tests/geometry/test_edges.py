"""Numbers of edges against sorted pairs, and how often each is run through against a count in Python."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from guidefield.geometry.closed import edge_counts, numbered_edges


def random_triangles(rng: np.random.Generator, count: int, vertices: int) -> np.ndarray:
    """Triangles in which a vertex may stand twice."""
    return rng.integers(0, vertices, (count, 3))


def fan(count: int, rng: np.random.Generator) -> np.ndarray:
    """Triangles about one vertex, in any order."""
    rim = np.arange(1, count + 1)
    return rng.permutation(np.column_stack([np.zeros(count, int), rim, np.roll(rim, -1)]))


@pytest.mark.parametrize("seed", range(8))
def test_numbers_are_those_of_sorted_pairs(seed: int) -> None:
    rng = np.random.default_rng(seed)
    triangles = fan(500, rng) if seed % 2 else random_triangles(rng, 300, 3 + 40 * seed)
    sides = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    _, expected = np.unique(sides, axis=0, return_inverse=True)
    numbers, count = numbered_edges(triangles)
    np.testing.assert_array_equal(numbers, expected.reshape(-1))
    assert count == expected.max() + 1


@pytest.mark.parametrize("seed", range(4))
def test_each_way_through_an_edge_is_counted(seed: int) -> None:
    triangles = random_triangles(np.random.default_rng(seed), 200, 12)
    ways = Counter((a, b) for one in triangles.tolist() for a, b in zip(one, one[1:] + one[:1], strict=True))
    edges = sorted({tuple(sorted(way)) for way in ways})
    upwards, downwards = edge_counts(triangles)
    assert upwards.tolist() == [ways[a, b] if a < b else 0 for a, b in edges]
    assert downwards.tolist() == [ways[b, a] for a, b in edges]


def test_no_triangles_have_no_edges() -> None:
    numbers, count = numbered_edges(np.empty((0, 3), np.int64))
    assert len(numbers) == count == 0
