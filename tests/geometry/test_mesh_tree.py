"""The tree over a mesh's triangles: its clusters and the nodes that may get a box are as many as were counted."""

from __future__ import annotations

import numpy as np
import pytest

from guidefield.geometry.mesh_tree import (
    BOXED,
    CLUSTERS,
    Cluster,
    cluster_counts,
    count_boxed,
    tree_written,
    triangle_tree,
)


@pytest.mark.parametrize("count", [1, 2, 5, 6, 21, 43, 200, 1001])
def test_clusters_are_as_many_as_were_counted(count: int) -> None:
    tree = triangle_tree(np.random.default_rng(count).normal(size=(count, 3, 3)))
    assert cluster_counts(count) == [len(nodes) for nodes, _ in tree.clusters]
    assert (tree.links[:, 0] >= 0).sum() == count - 1


@pytest.mark.parametrize("count", [1, 85, 86, 171, 1001, 2048, 2049, 5000])
def test_nodes_that_may_get_a_box_are_told_with_all_that_is_below(count: int) -> None:
    triangles, told = np.random.default_rng(count).normal(size=(count, 3, 3)), list[Cluster]()
    balls, links = np.empty((2 * count - 1, 4)), np.empty((2 * count - 1, 3), np.int64)
    tree_written(triangles, balls, links, told.append)
    assert count_boxed(count) == sum(len(nodes) for nodes, _ in told)
    for nodes, members in told:
        for node, row in zip(nodes.tolist(), members, strict=True):
            waiting, below = [node], set[int]()
            while waiting:
                left, right, triangle = links[waiting.pop()].tolist()
                below.update([triangle] if left < 0 else [])
                waiting += [] if left < 0 else [left, right]
            assert set(row.tolist()) == below
            assert CLUSTERS[-1] < len(below) <= BOXED
