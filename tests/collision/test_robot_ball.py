"""The ball holds a robot at all configurations, and there is none where a joint may go anywhere."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from guidefield.collision.bodies import bodies, joint_placements
from guidefield.collision.robot_ball import reach_ball
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.reduced_model import select
from tests.robots import box_arm, group, grouped, random_configuration, robot

TURNED = pin.SE3(pin.exp3(np.array([0.3, -0.8, 1.1])), np.array([1.0, -2.0, 0.5]))


def farthest(planned: PlanningGroup, seeds: int) -> float:
    """How far from the ball's centre the balls about bodies reach at random configurations [m]."""
    ball, about, data, reached = reach_ball(planned), bodies(planned), planned.model.createData(), 0.0
    for seed in range(seeds):
        pin.forwardKinematics(planned.model, data, planned.expand(random_configuration(planned, seed)))
        centres = about.centres_in_world(joint_placements(data)[None])[0]
        reached = max(reached, float((np.linalg.norm(centres - ball[:3], axis=1) + about.radii).max()))
    return reached


@pytest.mark.parametrize("name", ["panda", "ur5", "kinova", "tiago", "baxter"])
def test_robots_stay_in_it_wherever_they_stand(name: str) -> None:
    model = robot(name)
    for base in (pin.SE3.Identity(), TURNED):
        planned = select(model, None, None, model.rest, base)
        ball = reach_ball(planned)
        assert 0.5 * ball.radius < farthest(planned, 200) <= ball.radius


@pytest.mark.parametrize("joints", ["x oblique slide y screw", "slide slide slide", "continuous mimic gear x", "slide"])
def test_chains_of_every_kind_stay_in_it(joints: str) -> None:
    planned = grouped(box_arm(joints, 3))
    ball = reach_ball(planned)
    assert farthest(planned, 300) <= ball.radius


@pytest.mark.parametrize("joints", ["planar x", "x floating", "x planar y"])
def test_what_may_go_anywhere_has_none(joints: str) -> None:
    assert reach_ball(grouped(box_arm(joints, 2))) is None


def test_a_joint_that_slides_beyond_its_limits_may_go_anywhere() -> None:
    assert reach_ball(grouped(box_arm("x slide", 2)), limited=False) is None
    assert reach_ball(group("panda"), limited=False) == reach_ball(group("panda"))
