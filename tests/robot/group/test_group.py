"""Planning groups: what moves, where the robot stands, and local coordinates."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.errors import InvalidGroup, UnknownFrame
from guidefield.robot.group.kinematics import Kinematics
from guidefield.robot.group.reduced_model import select
from guidefield.robot.model.mimic_joints import follow
from tests.robots import ARMS, group, random_configuration, rest, robot

HERE = pin.SE3.Identity()


def tip_of_the_whole_robot(name: str, q_group: np.ndarray) -> pin.SE3:
    """Placement of the tip by the robot's own model, the group's joints set one by one."""
    planned = group(name)
    model = robot(name)
    q = model.rest.copy()
    for joint in planned.joints:
        whole = model.joint(joint.name)
        q[whole.idx_q : whole.idx_q + whole.nq] = q_group[joint.idx_q : joint.idx_q + joint.nq]
    follow(model.joints, q)
    data = model.model.createData()
    pin.framesForwardKinematics(model.model, data, q)
    return data.oMf[model.model.getFrameId(planned.tip)]


@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize("seed", range(3))
def test_the_reduced_robot_puts_the_tip_where_the_whole_one_does(name: str, seed: int) -> None:
    planned = group(name)
    q = random_configuration(planned, seed)
    found = Kinematics(planned).frame_placement(planned.expand(q), planned.tip_id)
    np.testing.assert_allclose(found.homogeneous, tip_of_the_whole_robot(name, q).homogeneous, atol=1e-12)


def test_a_placement_moves_the_whole_robot_and_its_shapes() -> None:
    model = robot("ur5")
    placement = pin.SE3(pin.exp3(np.array([0.1, 0.2, 0.3])), np.array([1.0, -2.0, 0.5]))
    here, there = (select(model, None, None, model.rest, at) for at in (HERE, placement))
    q = random_configuration(here, 3)
    np.testing.assert_allclose(
        Kinematics(there).frame_placement(q, there.tip_id).homogeneous,
        (placement * Kinematics(here).frame_placement(q, here.tip_id)).homogeneous,
        atol=1e-12,
    )
    for a, b in zip(here.geometry.geometryObjects, there.geometry.geometryObjects, strict=True):
        if a.parentJoint == 0:
            np.testing.assert_allclose(b.placement.homogeneous, (placement * a.placement).homogeneous, atol=1e-12)
    # the robot itself is untouched
    assert model.model.jointPlacements[1] == robot("ur5").model.jointPlacements[1]


@pytest.mark.parametrize(
    ("asked", "match"),
    [
        ("legs", "no group 'legs'; it has"),
        (["panda_joint9"], "no movable joint 'panda_joint9'"),
        (["panda_finger_joint2"], "mimics 'panda_finger_joint1'"),
    ],
)
def test_what_cannot_be_planned_for_is_named(asked: str | list[str], match: str) -> None:
    model = robot("panda")
    with pytest.raises(InvalidGroup, match=match):
        select(model, asked, None, model.rest, HERE)


def test_an_unknown_tip_lists_the_frames() -> None:
    model = robot("panda")
    with pytest.raises(UnknownFrame, match="no frame 'nose'") as refused:
        select(model, None, "nose", model.rest, HERE)
    assert "panda_hand" in refused.value.details["available"]


@given(seed=st.integers(0, 10_000), turns=st.integers(-3, 3))
@settings(max_examples=15)
def test_whole_turns_of_continuous_joints_change_nothing_but_local_coordinates(seed: int, turns: int) -> None:
    planned = group("kinova")
    z = planned.to_local(random_configuration(planned, seed))
    near = z + 2.0 * np.pi * turns * (~np.isfinite(planned.lower))
    unwrapped = planned.unwrapped(z, near + 0.1)
    np.testing.assert_allclose(unwrapped, near, atol=1e-9)
    np.testing.assert_allclose(planned.from_local(unwrapped), planned.from_local(z), atol=1e-12)


def test_links_and_fixed_joints_may_share_names() -> None:
    arm = robot("z1")
    assert sum(frame.name == "gripperStator" for frame in arm.model.frames) == 2
    planned = select(arm, ["joint1", "joint3"], None, arm.rest, HERE)
    assert planned.model.existBodyName("gripperStator")
    for q in (rest(planned), random_configuration(planned, 1)):
        whole = arm.rest.copy()
        for joint in planned.joints:
            of_robot = arm.joint(joint.name)
            whole[of_robot.idx_q] = q[joint.idx_q]
        data = arm.model.createData()
        pin.framesForwardKinematics(arm.model, data, whole)
        there = data.oMf[arm.model.getFrameId(planned.tip, pin.BODY)]
        assert Kinematics(planned).frame_placement(planned.expand(q), planned.tip_id).isApprox(there, 1e-12)
