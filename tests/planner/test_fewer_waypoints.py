"""Paths across guide planes with fewer waypoints: no longer, through the same crossings, clear of obstacles."""

from __future__ import annotations

import numpy as np
from hypothesis import given, strategies as st

from guidefield.planner.finish import remove_waypoints
from tests.planner.problems import problem, scene_of

FREE = problem("panda", scene_of())


def wandering(seed: int, steps: int) -> np.ndarray:
    """A path of small steps about a straight one."""
    rng = np.random.default_rng(seed)
    along = np.linspace(0.0, 1.0, steps)[:, None] * rng.uniform(-0.5, 0.5, FREE.group.nv)
    return FREE.z_start + along + rng.normal(scale=0.02, size=along.shape)


@given(st.integers(0, 1000), st.integers(3, 12), st.data())
def test_a_path_in_the_open_is_straight_between_its_crossings(seed: int, steps: int, data: st.DataObject) -> None:
    path = wandering(seed, steps)
    at = data.draw(st.lists(st.integers(0, steps - 1), max_size=3))
    fewer = remove_waypoints(FREE, path, dict(enumerate(at)))
    np.testing.assert_allclose(fewer, path[sorted({0, steps - 1, *at})], atol=1e-6, err_msg="kernels go in float32")
    np.testing.assert_array_equal(fewer[[0, -1]], path[[0, -1]])
