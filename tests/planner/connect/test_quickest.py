"""Which of several goals is reached soonest."""

from __future__ import annotations

import dataclasses
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, strategies as st

from guidefield.planner.connect.connect import estimate_time, find_quickest_path
from guidefield.planner.task.problem import Objective
from tests.planner.connect.test_connect import wall_between
from tests.planner.problems import densely_free, problem, scene_of


@given(st.integers(0, 10_000), st.integers(2, 8))
def test_a_time_is_between_the_straight_ones_and_that_of_waiting_for_the_slowest(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    path, velocities = rng.normal(size=(count, 4)), rng.uniform(0.1, 3.0, 4)
    time = estimate_time(path, velocities)
    straight = max(abs(float(a)) / float(v) for a, v in zip(path[-1] - path[0], velocities, strict=True))
    waiting = sum(max(np.abs(b - a) / velocities) for a, b in pairwise(path))
    assert straight * (1 - 1e-12) <= time <= waiting * (1 + 1e-12)
    assert estimate_time(path[[0, -1]], velocities) == pytest.approx(straight)


def test_a_goal_behind_a_wall_is_passed_by_for_one_that_is_farther_but_reached_sooner() -> None:
    made, start, behind = wall_between()
    aside = start.copy()
    aside[0] += 1.85  # a little more than through the wall
    assert densely_free(made, np.array([start, aside]))
    rng = np.random.default_rng(0)
    way = find_quickest_path(made, start, np.array([behind, aside]), rng)
    assert way.tried == 2
    np.testing.assert_array_equal(way.path, [start, aside])
    alone = find_quickest_path(made, start, behind[None], rng)
    assert len(alone.path) > 2
    limits = made.group.velocity_limits
    assert estimate_time(alone.path, limits) > estimate_time(way.path, limits)


def test_of_two_goals_as_soon_the_one_with_the_shorter_way_is_taken_unless_time_alone_counts() -> None:
    made = problem("panda", scene_of())
    z, limits = made.group.chart(made.q_start), made.group.velocity_limits
    one_joint, all_joints = z + 0.1 * np.eye(7)[0] * limits, z + 0.099 * limits
    goals = np.array([all_joints, one_joint])
    for objective, taken in ((Objective.BALANCED, one_joint), (Objective.TIME, all_joints)):
        way = find_quickest_path(dataclasses.replace(made, objective=objective), z, goals, np.random.default_rng(0))
        np.testing.assert_array_equal(way.path, [z, taken])
