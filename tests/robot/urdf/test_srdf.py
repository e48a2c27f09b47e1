"""An SRDF is read as strictly as a URDF, and what it names in vain is told."""

import numpy as np
import pinocchio as pin
import pytest

from guidefield.errors import RobotInvalid
from guidefield.messages.requests import UrdfText
from guidefield.robot.group.reduced_model import select
from guidefield.robot.urdf.srdf import parse
from tests.robots import box_arm, load


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("<robot", "line 1: the SRDF is not XML"),
        ('<robot xmlns:xacro="x/xacro"><xacro:include filename="g"/></robot>', "line 1: this is a xacro file"),
        ("<a/>", "root element must be <robot>, it is <a>"),
        ("<!DOCTYPE a [<!ENTITY x 'y'>]>\n<robot/>", "line 1: an SRDF must not have a <!DOCTYPE>"),
        ("<robot>\ud800</robot>", "half a surrogate pair"),
        (f"<robot>{' ' * 4_000_000}</robot>", "at most 4000000 are read"),
        (
            '<robot><group_state name="s"><joint name="j" value="nan"/></group_state></robot>',
            "'nan', which is no number",
        ),
        ('<robot><group_state name="s"><joint name="j" value=""/></group_state></robot>', "'', which is no number"),
    ],
)
def test_what_is_refused(text: str, words: str) -> None:
    with pytest.raises(RobotInvalid) as refused:
        parse(text)
    assert words in refused.value.message


def test_a_urdf_in_the_place_of_the_srdf_is_told() -> None:
    assert "is this a URDF?" in parse(box_arm("y", 2).text).warnings[0]


def test_names_that_the_robot_does_not_have_are_told() -> None:
    srdf = (
        '<robot name="arm"><disable_collisions link1="l0" link2="ghost" reason="Never"/><group name="g">'
        '<joint name="j1"/><joint name="j8"/><joint name="j9"/><chain base_link="l0" tip_link="hand"/></group></robot>'
    )
    warnings = load(UrdfText(text=box_arm("y", 3).text, srdf=srdf)).warnings
    assert "the SRDF's pairs name link 'ghost', which the robot doesn't have" in warnings
    assert "the SRDF's groups and states name joints 'j8', 'j9', which the robot doesn't have" in warnings
    assert "the SRDF's groups name link 'hand', which the robot doesn't have" in warnings


def test_a_state_places_a_root_joint_of_the_kind_that_it_was_written_for() -> None:
    root = '<joint name="root_joint" value="0. 0. 0.55 0. 0. 0.707 0.707"/>'
    state = f'<group_state name="rest" group="g">{root}<joint name="j1" value="0.3"/></group_state>'
    urdf, srdf = box_arm("y", 1).text, f'<robot name="arm">{state}</robot>'
    free = load(UrdfText(text=urdf, srdf=srdf, root_joint="free"))
    np.testing.assert_allclose(free.rest, [0.0, 0.0, 0.55, 0.0, 0.0, 0.5**0.5, 0.5**0.5, 0.3])
    planar = load(UrdfText(text=urdf, srdf=srdf, root_joint="planar"))
    np.testing.assert_array_equal(planar.rest, [0.0, 0.0, 1.0, 0.0, 0.3])
    np.testing.assert_array_equal(load(UrdfText(text=urdf, srdf=srdf)).rest, [0.3])


def rested(srdf: str, root: str = "fixed") -> tuple[list[float], str | None, list[str]]:
    """Values of a rest configuration, the state it is of, and what is told about the SRDF."""
    model = load(UrdfText(text=box_arm("y x", 1).text, srdf=f'<robot name="arm">{srdf}</robot>', root_joint=root))
    return model.rest.tolist(), model.rest_state, [told for told in model.warnings if "SRDF" in told]


def state(name: str, j1: str, group: str = "g") -> str:
    return f'<group_state name="{name}" group="{group}"><joint name="j1" value="{j1}"/></group_state>'


GROUP = '<group name="g"><joint name="j1"/><joint name="j2"/></group>'


def test_a_state_beyond_the_limits_is_not_the_rest_configuration_where_another_is_within() -> None:
    values, name, told = rested(GROUP + state("home", "5") + state("up", "0.4"))
    assert (values, name) == ([0.4, 0.0], "up")
    assert told == [
        "the SRDF's state 'home' is beyond limits (joint 'j1' at 5, its limits are -2 and 2): it is not the rest"
        " configuration"
    ]
    values, name, told = rested(GROUP + state("home", "5"))
    assert (values, name) == ([2.0, 0.0], "home")
    assert "the rest configuration has the limit instead" in told[0]


def test_a_virtual_joint_stands_for_the_root_joint() -> None:
    virtual = '<virtual_joint name="floor" type="planar" parent_frame="odom" child_link="l0"/>'
    placed = '<group_state name="home" group="g"><joint name="floor" value="1 2 0.5"/></group_state>'
    values, _, told = rested(GROUP + virtual + placed, "planar")
    np.testing.assert_allclose(values, [1, 2, np.cos(0.5), np.sin(0.5), 0, 0])
    assert not told
    assert rested(GROUP + virtual)[2] == [
        "the SRDF's virtual joint 'floor' is planar, but the robot's root is fixed: `root_joint` may be 'planar'"
    ]


def test_passive_joints_are_planned_for_only_by_name() -> None:
    srdf = f'<robot name="arm">{GROUP}<group name="h"><joint name="j2"/></group><passive_joint name="j2"/></robot>'
    model = load(UrdfText(text=box_arm("y x", 1).text, srdf=srdf))
    assert model.groups == {"g": ("j1",)}
    assert "the SRDF's group 'h' is left out: its joints don't move by themselves (j2 is passive)" in model.warnings
    here = pin.SE3.Identity()
    assert select(model, None, None, model.rest, here).position_names == ["j1"]
    assert select(model, ["j2"], None, model.rest, here).position_names == ["j2"]


def test_groups_that_are_left_out_are_told_with_their_reason() -> None:
    told = rested(
        '<group name="g"/><group name="g"/><group name="h"><link name="ghost"/></group>'
        '<group name="i"><group name="gone"/></group>'
    )[2]
    assert "the SRDF's groups name group 'gone', which the SRDF doesn't have" in told
    assert "the SRDF: line 1: a second group 'g' is left out" in told
    assert "the SRDF's group 'g' is left out: it is empty" in told
    assert "the SRDF's group 'h' is left out: no joint that moves is among what it names" in told
