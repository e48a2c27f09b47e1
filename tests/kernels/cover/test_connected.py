"""Pieces are those that a search from vertex to vertex finds, by their lowest vertex."""

from __future__ import annotations

import networkx as nx
import numpy as np
from hypothesis import given, settings, strategies as st

from guidefield.kernels.cover.merge_points import lowest_connected


@settings(deadline=None, max_examples=18)
@given(st.integers(1, 60), st.integers(0, 60), st.sampled_from([2, 3]), st.integers(0, 10**6))
def test_each_piece_is_told_by_its_lowest_vertex(count: int, simplices: int, corners: int, seed: int) -> None:
    drawn = np.random.default_rng(seed).integers(0, count, (simplices, corners))
    labels = np.empty(count, np.int64)
    lowest_connected(drawn, labels)
    graph = nx.Graph()
    graph.add_nodes_from(range(count))
    for row in drawn.tolist():
        nx.add_path(graph, row)
    expected = np.empty(count, np.int64)
    for piece in nx.connected_components(graph):
        expected[list(piece)] = min(piece)
    np.testing.assert_array_equal(labels, expected)
