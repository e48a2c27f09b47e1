"""Configurations between the wire and Pinocchio."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.errors import InvalidConfiguration, InvalidGoal
from guidefield.robot.model.configuration import clamp, configuration_from_wire, configuration_to_wire, limit_faults
from tests.robots import box_arm, load, robot


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
