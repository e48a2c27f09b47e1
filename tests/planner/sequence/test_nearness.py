"""A goal that is passed, as a place: nothing is missed within its radius, and derivatives are finite differences."""

from __future__ import annotations

import numpy as np
import pytest
from tests.planner.problems import problem, scene_of, to_configuration
from tests.robots import group

from guidefield.planner.sequence.joined import INSIDE, PassedGoal
from guidefield.planner.task.problem import Goal, TipGoal
from guidefield.robot.ik.pose_search import PoseTarget


def goal(of_tip: bool, radius: float) -> PassedGoal:
    """A goal of a UR5 about a configuration."""
    arm = group("ur5")
    z = np.array([0.3, -1.2, 1.1, -0.7, 0.9, 0.2])
    asked: Goal = to_configuration(z, arm)
    if of_tip:
        kinematics = problem(arm, scene_of(), goal=asked, q_start=arm.from_chart(z)).kinematics
        asked = TipGoal(PoseTarget(kinematics.frame_placement(arm.expand_from_chart(z), arm.tip_id), *np.zeros((2, 3))))
    return PassedGoal(problem(arm, scene_of(), goal=asked, q_start=arm.from_chart(z)), z, radius)


@pytest.mark.parametrize("of_tip", [False, True], ids=["joints", "tip"])
def test_nothing_is_missed_exactly_within_the_radius(of_tip: bool) -> None:
    passed = goal(of_tip, 0.1)
    zs = passed.z + 0.1 * np.random.default_rng(0).normal(size=(60, 6))
    within = passed.distances(zs) <= INSIDE * passed.radius
    assert 0 < within.sum() < len(zs)
    np.testing.assert_array_equal((passed.missed(zs) == 0.0).all(axis=1), within)
    beyond = passed.missed(zs).max(axis=1)[~within] + INSIDE * passed.radius
    np.testing.assert_allclose(beyond, passed.distances(zs)[~within], atol=1e-12)


@pytest.mark.parametrize("of_tip", [False, True], ids=["joints", "tip"])
def test_its_rows_are_finite_differences_of_what_is_missed(of_tip: bool) -> None:
    passed, step = goal(of_tip, 0.05), 1e-6
    for z in passed.z + 0.3 * np.random.default_rng(1).normal(size=(5, 6)):
        moved = step * np.eye(6)
        differences = (passed.missed(z + moved) - passed.missed(z - moved)).T / (2.0 * step)
        np.testing.assert_allclose(passed.rows(z), differences, atol=1e-7)
    assert not passed.rows(passed.z).any()
