"""Trees of chart points: nearest nodes, arrays that grow, branches."""

from __future__ import annotations

import numpy as np

from guidefield.planner.connect.tree import Tree
from tests.robots import box_arm, grouped


def test_trees_grow_and_find_what_is_nearest() -> None:
    tree = Tree(grouped(box_arm("y y", 2)), np.array([[3.0, 0.0], [0.0, 0.0]]))
    assert tree.nearest(np.array([2.0, 0.5])) == 0
    assert tree.nearest(np.array([-3.0, 0.0])) == 1
    for i in range(200):
        assert tree.add(np.array([float(i), 1.0]), i) == i + 2
    assert tree.nearest(np.array([150.2, 1.0])) == 152
    np.testing.assert_array_equal(tree.branch(4), [[3.0, 0.0], [0.0, 1.0], [2.0, 1.0]])
