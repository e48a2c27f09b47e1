"""Paths across guide planes with fewer waypoints: no longer, through the same crossings, clear of obstacles."""

from __future__ import annotations

import numpy as np
from hypothesis import given, strategies as st

from guidefield.collision.clearance import clearance_at
from guidefield.planner.finish import STRAIGHT_MARGIN, remove_waypoints
from guidefield.planner.motion.waypoints import length_of, subdivide
from guidefield.planner.task.problem import Problem
from tests.planner.problems import problem, scene_of
from tests.planner.walls import over_the_wall

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


def test_straight_ways_keep_their_distance_from_a_wall() -> None:
    made, short = over_the_wall()
    rng = np.random.default_rng(1)
    path = subdivide(short, 0.2)
    path[1:-1] += rng.normal(scale=0.01, size=path[1:-1].shape)
    fewer = remove_waypoints(made, path, {})
    assert len(fewer) < len(path)
    assert length_of(fewer) < length_of(path)
    kept = least_distance(made, fewer)
    assert kept > min(least_distance(made, path), STRAIGHT_MARGIN) - 1e-3, "between samples a little may be lost"
    assert least_distance(made, path[[0, -1]]) < kept, "the straight way from end to end is nearer"


def least_distance(made: Problem, path: np.ndarray) -> float:
    """From obstacles, by Coal at dense samples [m]."""
    return min(
        clearance_at(made.world, made.group.expand_from_chart(z)).obstacle_distance for z in subdivide(path, 0.02)
    )
