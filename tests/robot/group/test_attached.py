"""HeldShape objects are bodies of the robot: placed by their link, tested against what they may not touch."""

import coal
import numpy as np
import pinocchio as pin
import pytest

from guidefield.errors import UnknownFrame, UnknownObject
from guidefield.handlers.attached import HeldShape, add_held_links
from guidefield.messages.requests import UrdfText
from guidefield.robot.group.reduced_model import select
from tests.robots import load, random_configuration, robot

IN_HAND = pin.SE3(pin.exp3(np.array([0.1, 0.2, 0.3])), np.array([0.02, 0.0, 0.15]))


def rod(name: str = "rod", link: str = "panda_hand", touch: tuple[str, ...] = ()) -> HeldShape:
    return HeldShape(name, coal.Cylinder(0.01, 0.4), IN_HAND, link, touch)


def grouped(model):
    return select(model, None, None, model.rest, pin.SE3(np.eye(3), np.array([0.3, 0.0, 0.1])))


def test_it_moves_with_its_link():
    arm = grouped(add_held_links(robot("panda"), [rod()]))
    bare = grouped(robot("panda"))
    assert arm.geometry.ngeoms == bare.geometry.ngeoms + 1
    data, geometry_data = arm.model.createData(), arm.geometry.createData()
    for seed in range(5):
        q = random_configuration(bare, seed)
        pin.updateGeometryPlacements(arm.model, data, arm.geometry, geometry_data, q)
        pin.framesForwardKinematics(arm.model, data, q)
        hand = data.oMf[arm.model.getFrameId("panda_hand", pin.FrameType.BODY)]
        for placed in (geometry_data.oMg[arm.geometry.ngeoms - 1], data.oMf[arm.model.getFrameId("rod")]):
            np.testing.assert_allclose(placed.homogeneous, (hand * IN_HAND).homogeneous, atol=1e-12)


FOLLOWED = """<robot name="followed"><link name="base"/>
<joint name="a" type="revolute"><parent link="base"/><child link="l1"/><axis xyz="0 0 1"/>
<limit lower="-2" upper="2" effort="1" velocity="2"/></joint>
<link name="l1"><collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>
<joint name="f" type="prismatic"><origin xyz="0.3 0 0"/><parent link="l1"/><child link="l2"/><axis xyz="1 0 0"/>
<limit lower="-1" upper="1" effort="1" velocity="2"/><mimic joint="a" multiplier="0.1"/></joint>
<link name="l2"><collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>
<joint name="b" type="revolute"><origin xyz="0.3 0 0"/><parent link="l2"/><child link="l3"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" effort="1" velocity="2"/></joint>
<link name="l3"><collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link></robot>"""


@pytest.mark.parametrize("holder", ["l1", "l2", "l3"])
def test_it_has_a_frame_after_joints_were_locked_and_mimic_joints_left_out(holder: str) -> None:
    """Where a body's frame was none, reducing the model a second time read beyond the frames: a crash at times."""
    held = add_held_links(load(UrdfText(text=FOLLOWED)), [rod(link=holder)])
    arm = select(held, ["a"], holder, held.rest, pin.SE3.Identity())
    bodies = list(arm.geometry.geometryObjects)
    assert "rod" in [body.name for body in bodies]
    for body in bodies:
        assert body.parentFrame < arm.model.nframes
        assert arm.model.frames[body.parentFrame].parentJoint == body.parentJoint


def against(model, name: str) -> set[str]:
    links = [choice.link for choice in model.geometry_choices]
    pairs = [(links[pair.first], links[pair.second]) for pair in model.geometry.collisionPairs]
    return {other for pair in pairs if name in pair for other in pair if other != name}


def test_it_is_tested_against_what_it_may_not_touch():
    fingers = ("panda_leftfinger", "panda_rightfinger")
    assert set(fingers) <= against(add_held_links(robot("panda"), [rod()]), "rod")
    holding = add_held_links(robot("panda"), [rod(touch=fingers)])
    others = against(holding, "rod")
    assert not others & {"panda_hand", *fingers}
    assert {"panda_link0", "panda_link5"} <= others
    assert robot("panda").links == tuple(link for link in holding.links if link != "rod")


def test_names_must_fit():
    with pytest.raises(UnknownFrame, match="no_link"):
        add_held_links(robot("panda"), [rod(link="no_link")])
    with pytest.raises(UnknownFrame, match="no_link"):
        add_held_links(robot("panda"), [rod(touch=("no_link",))])
    with pytest.raises(UnknownObject, match="panda_hand"):
        add_held_links(robot("panda"), [rod("panda_hand")])
    with pytest.raises(UnknownObject, match="rod"):
        add_held_links(robot("panda"), [rod(), rod()])


@pytest.mark.parametrize(("name", "what"), [("panda_joint3", "frame"), ("panda_link5_0", "collision shape")])
def test_names_that_the_robot_has_for_something_else_are_refused(name: str, what: str):
    with pytest.raises(UnknownObject, match=f"'{name}' has the name of a {what}"):
        add_held_links(robot("panda"), [rod(name)])
