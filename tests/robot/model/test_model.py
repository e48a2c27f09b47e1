"""The robot's model: a link before a joint of its name; ball joints, everything else as it was."""

import numpy as np
import pinocchio as pin
import pytest

from guidefield.errors import RobotInvalid
from guidefield.messages.requests import UrdfText
from guidefield.robot.model.joints import JointKind
from guidefield.robot.model.model import frame_index, with_ball_joints
from tests.robots import box_arm, load, robot


def test_marked_joints_only_turn_and_the_rest_stays_as_it_is() -> None:
    model = load(box_arm("y floating slide", 0)).model
    balled = with_ball_joints("arm", model, ["j2"])
    assert (balled.nq, balled.nv) == (1 + 4 + 1, 1 + 3 + 1)
    assert [f.name for f in balled.frames] == [f.name for f in model.frames]
    assert balled.lowerPositionLimit[0] == model.lowerPositionLimit[0]
    assert balled.velocityLimit[-1] == model.velocityLimit[-1]
    turn = pin.Quaternion(pin.exp3(np.array([0.3, -0.2, 0.5]))).coeffs()
    q, q_ball = np.r_[0.4, 0.0, 0.0, 0.0, turn, 0.1], np.r_[0.4, turn, 0.1]
    data, data_ball = model.createData(), balled.createData()
    pin.framesForwardKinematics(model, data, q)
    pin.framesForwardKinematics(balled, data_ball, q_ball)
    for index in range(model.nframes):
        assert data.oMf[index].isApprox(data_ball.oMf[index], 1e-12)


@pytest.mark.parametrize(("marked", "match"), [("j9", "has no joint 'j9'"), ("j1", "isn't floating")])
def test_a_mark_that_fits_nothing_is_refused(marked: str, match: str) -> None:
    with pytest.raises(RobotInvalid, match=match):
        with_ball_joints("arm", load(box_arm("y floating", 0)).model, [marked])


@pytest.mark.parametrize("name", ["chain_fixed_6x300_r25", "chain_moving_3x260_r20"])
def test_the_seeds_chains_are_balls(name: str) -> None:
    kinds = [joint.kind for joint in robot(name).joints]
    moving = "moving" in name
    assert kinds.count(JointKind.SPHERICAL) == (2 if moving else 6)
    assert (kinds[0] is JointKind.FLOATING) == moving


SHARED = (
    '<robot name="r"><link name="a"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>'
    '<link name="b"/>'
    '<joint name="b" type="revolute"><origin xyz="0 0 1"/><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>'
    '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>'
)


def test_the_link_is_meant() -> None:
    model = load(UrdfText(text=SHARED)).model
    index = frame_index(model, "b")
    assert index is not None
    assert model.frames[index].type.name == "BODY"
    assert load(UrdfText(text=SHARED)).frame_id("b") == index
