"""The tree of boxes: nothing is lost, and every node contains what is below it."""

from __future__ import annotations

import numpy as np
import pytest

from guidefield.geometry.curve_order import along_curve
from guidefield.geometry.surface_rows import box_nodes
from guidefield.kernels.distance.triangle_distance import LEAF


def boxes(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    low = rng.normal(size=(count, 3))
    return low, low + rng.uniform(0.0, 0.3, (count, 3))


def tree_over(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nodes, and the order in which the leaves hold the boxes."""
    order = along_curve(0.5 * (low + high)).order
    return box_nodes(np.hstack([low, high])[order]), order


@pytest.mark.parametrize("count", [1, LEAF, LEAF + 1, 37, 1000])
def test_every_box_stands_in_one_leaf_and_every_node_contains_what_is_below(count: int) -> None:
    low, high = boxes(count)
    nodes, order = tree_over(low, high)
    leaves = (len(nodes) + 1) // 2
    assert sorted(order) == list(range(count))
    for leaf in range(leaves):
        node = nodes[leaves - 1 + leaf]
        held = order[leaf * LEAF : (leaf + 1) * LEAF]
        if not len(held):
            assert (node[:3] == np.inf).all()
            assert (node[3:] == -np.inf).all()
            continue
        np.testing.assert_array_equal(node, np.r_[low[held].min(axis=0), high[held].max(axis=0)])
    for parent in range(leaves - 1):
        below = nodes[[2 * parent + 1, 2 * parent + 2]]
        assert (nodes[parent, :3] <= below[:, :3].min(axis=0)).all()
        assert (nodes[parent, 3:] >= below[:, 3:].max(axis=0)).all()


def test_neighbours_share_leaves() -> None:
    points = np.stack(np.meshgrid(*[np.arange(8.0)] * 3), axis=-1).reshape(-1, 3)
    _, order = tree_over(points, points)
    sizes = np.ptp(points[order].reshape(-1, LEAF, 3), axis=1).max(axis=1)
    assert sizes.max() <= 1.0


def test_boxes_at_one_place_are_fine() -> None:
    nodes, _ = tree_over(np.zeros((50, 3)), np.ones((50, 3)))
    np.testing.assert_array_equal(nodes[0], [0, 0, 0, 1, 1, 1])
