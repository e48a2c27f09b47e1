"""An SRDF is read as strictly as a URDF, and what it names in vain is told."""

import numpy as np
import pytest

from guidefield.errors import RobotInvalid
from guidefield.messages.requests import UrdfText
from guidefield.robot.urdf.srdf import parse
from tests.robots import box_arm, load


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("<robot", "line 1: the SRDF is not XML"),
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


def test_names_that_the_robot_does_not_have_are_told() -> None:
    srdf = (
        '<robot name="arm"><disable_collisions link1="l0" link2="ghost" reason="Never"/><group name="g">'
        '<joint name="j1"/><joint name="j8"/><joint name="j9"/><chain base_link="l0" tip_link="hand"/></group></robot>'
    )
    warnings = load(UrdfText(text=box_arm("y", 3).text, srdf=srdf)).warnings
    assert "the SRDF's pairs name link 'ghost', which the robot doesn't have" in warnings
    assert "the SRDF's groups and states name joint 'j8' and 1 more, which the robot doesn't have" in warnings
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
