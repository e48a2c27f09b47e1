"""Goal poses whose tolerances are wider than the path constraints: configurations that keep both are found."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from guidefield.planner.connect.connect import PoseKeeper
from guidefield.planner.ends import find_goal_points
from guidefield.planner.task.problem import TipGoal
from guidefield.robot.group.path_constraints import Cone, line, plane, point
from guidefield.robot.ik.inverse_kinematics import PoseTarget
from tests.planner.problems import problem, scene_of

DOWN = pin.SE3(pin.Quaternion(0.0, 1.0, 0.0, 0.0).matrix(), np.array([0.45, 0.2, 0.45]))
PLACE = np.array([0.45, 0.2, 0.45])
X, Y, Z = np.eye(3)

CONSTRAINTS: dict[str, Any] = {
    "cone": Cone("panda_hand_tcp", Z, -Z, 1e-4),
    "cone beside the goal": Cone("panda_hand_tcp", Z, np.array([np.sin(8e-4), 0.0, -np.cos(8e-4)]), 1e-4),
    "plane": plane("panda_hand_tcp", PLACE + 8e-4 * Z, Z, 5e-5),
    "line": line("panda_hand_tcp", PLACE + 6e-4 * Y, X, 5e-5),
    "point": point("panda_hand_tcp", PLACE + 4e-4, 5e-5),
}


@pytest.mark.parametrize("constraint", CONSTRAINTS.values(), ids=CONSTRAINTS)
def test_goals_keep_narrow_constraints_within_their_tolerances(constraint: Any) -> None:
    target = PoseTarget(DOWN, np.full(3, 1e-3), np.full(3, 1e-3))
    made = problem("panda", scene_of(), TipGoal(target), path_constraints=(constraint,))
    goals = find_goal_points(made)
    assert goals is not None
    assert len(goals) > 1
    frames = made.constrained_frames
    for z in goals:
        placed = made.kinematics.frame_placement(made.group.expand_from_chart(z), made.group.tip_id)
        assert target.is_reached(placed)
        assert constraint.value(placed) <= constraint.limit
        assert frames.values(z)[0] <= constraint.limit
        assert ((z >= made.group.lower) & (z <= made.group.upper)).all()


def test_a_goal_that_no_tolerance_brings_to_the_constraint_stays_as_it_is() -> None:
    target = PoseTarget(DOWN, np.full(3, 1e-3), np.full(3, 1e-3))
    far = plane("panda_hand_tcp", PLACE + 0.01 * Z, Z, 5e-5)
    free = find_goal_points(problem("panda", scene_of(), TipGoal(target)))
    made = problem("panda", scene_of(), TipGoal(target), path_constraints=(far,))
    assert free is not None
    assert np.array_equal(PoseKeeper(made, target)(free), free)
