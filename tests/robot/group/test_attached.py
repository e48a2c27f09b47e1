"""Held objects are bodies of the robot: placed by their link, tested against what they may not touch."""

import coal
import numpy as np
import pinocchio as pin
import pytest

from guidefield.errors import UnknownFrame, UnknownObject
from guidefield.robot.group.attached import Held, with_held
from guidefield.robot.group.reduced_model import select
from tests.robots import random_configuration, robot

IN_HAND = pin.SE3(pin.exp3(np.array([0.1, 0.2, 0.3])), np.array([0.02, 0.0, 0.15]))


def rod(name: str = "rod", link: str = "panda_hand", touch: tuple[str, ...] = ()) -> Held:
    return Held(name, coal.Cylinder(0.01, 0.4), IN_HAND, link, touch)


def grouped(model):
    return select(model, None, None, model.rest, pin.SE3(np.eye(3), np.array([0.3, 0.0, 0.1])))


def test_it_moves_with_its_link():
    arm = grouped(with_held(robot("panda"), [rod()]))
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


def against(model, name: str) -> set[str]:
    links = [choice.link for choice in model.geometry_choices]
    pairs = [(links[pair.first], links[pair.second]) for pair in model.geometry.collisionPairs]
    return {other for pair in pairs if name in pair for other in pair if other != name}


def test_it_is_tested_against_what_it_may_not_touch():
    fingers = ("panda_leftfinger", "panda_rightfinger")
    assert set(fingers) <= against(with_held(robot("panda"), [rod()]), "rod")
    holding = with_held(robot("panda"), [rod(touch=fingers)])
    others = against(holding, "rod")
    assert not others & {"panda_hand", *fingers}
    assert {"panda_link0", "panda_link5"} <= others
    assert robot("panda").links == tuple(link for link in holding.links if link != "rod")


def test_what_is_held_may_hold_and_two_that_move_as_one_are_not_tested():
    second = Held("flag", coal.Box(0.1, 0.1, 0.01), pin.SE3.Identity(), "rod")
    third = Held("bag", coal.Sphere(0.05), pin.SE3.Identity(), "panda_link4")
    holding = with_held(robot("panda"), [rod(), second, third])
    assert "rod" not in against(holding, "flag")
    assert {"rod", "flag"} <= against(holding, "bag")


def test_names_must_fit():
    with pytest.raises(UnknownFrame, match="no_link"):
        with_held(robot("panda"), [rod(link="no_link")])
    with pytest.raises(UnknownFrame, match="no_link"):
        with_held(robot("panda"), [rod(touch=("no_link",))])
    with pytest.raises(UnknownObject, match="panda_hand"):
        with_held(robot("panda"), [rod("panda_hand")])
    with pytest.raises(UnknownObject, match="rod"):
        with_held(robot("panda"), [rod(), rod()])


@pytest.mark.parametrize(("name", "what"), [("panda_joint3", "frame"), ("panda_link5_0", "collision shape")])
def test_names_that_the_robot_has_for_something_else_are_refused(name: str, what: str):
    with pytest.raises(UnknownObject, match=f"'{name}' has the name of a {what}"):
        with_held(robot("panda"), [rod(name)])
