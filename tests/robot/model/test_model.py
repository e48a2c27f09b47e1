"""The robot's model: a link before a joint of its name, ball joints, and values of joints as the wire has them."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.errors import InvalidConfiguration, InvalidGoal, RobotInvalid
from guidefield.messages.requests import UrdfText
from guidefield.robot.model.configuration import clamp, configuration_from_wire, configuration_to_wire, limit_faults
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


@given(angle=st.floats(-50, 50))
@settings(max_examples=15)
def test_continuous_angles_survive_up_to_whole_turns(angle: float) -> None:
    model = robot("kinova")
    q = configuration_from_wire(model, {"j2s6s200_joint_1": angle})
    back = configuration_to_wire(model.joints, q)["j2s6s200_joint_1"]
    assert np.cos(back) == pytest.approx(np.cos(angle), abs=1e-9)
    assert np.sin(back) == pytest.approx(np.sin(angle), abs=1e-9)


@pytest.mark.parametrize(
    ("positions", "match"),
    [
        ({"panda_joint8": 0.0}, "no joint 'panda_joint8'; its joints are panda_joint1"),
        ({"panda_joint1": [0.0, 1.0]}, "'panda_joint1' is revolute: its value is one number, not a list of 2"),
        ({"panda_finger_joint2": 0.0}, "follows 'panda_finger_joint1'"),
    ],
)
def test_bad_values_are_named(positions: dict, match: str) -> None:
    with pytest.raises(InvalidConfiguration, match=match):
        configuration_from_wire(robot("panda"), positions)


@pytest.mark.parametrize(
    ("positions", "match"),
    [
        ({"j2": [1.0, 2.0]}, "'j2' is planar: its value has 3 numbers, not 2"),
        ({"j2": 1.0}, "its value has 3 numbers, not 1"),
        ({"j3": [0.0] * 6 + [0.9]}, "its quaternion must have norm 1"),
    ],
)
def test_bad_joints_of_several_values_are_named(positions: dict, match: str) -> None:
    with pytest.raises(InvalidConfiguration, match=match):
        configuration_from_wire(load(box_arm("y planar floating", 0)), positions)


def test_limit_faults_name_joint_value_and_limits() -> None:
    model = robot("panda")
    q = configuration_from_wire(model, {"panda_joint4": 0.5})
    (fault,) = limit_faults(model.joints, q)
    assert (fault.joint, fault.value, fault.upper) == ("panda_joint4", 0.5, pytest.approx(-0.0698))
    assert fault.excess == pytest.approx(0.5698)
    assert not limit_faults(model.joints, clamp(model.joints, q))


@pytest.mark.parametrize("value", [1.1e4, -1e300])
def test_no_value_is_further_than_can_be_judged(value: float) -> None:
    with pytest.raises(InvalidConfiguration, match="joint 'j1': a value may be 10000 at most"):
        configuration_from_wire(load(box_arm("continuous", 1)), {"j1": value})
    with pytest.raises(InvalidGoal, match="at most"):
        configuration_from_wire(load(box_arm("planar", 1)), {"j1": [value, 0.0, 0.0]}, error=InvalidGoal)
