from __future__ import annotations

import io

from rich.console import Console, RenderableType

from guidefield.cli.tables import robot_table, robots_table
from guidefield.engine import answer
from guidefield.messages.replies import RobotReply, RobotsReply, RobotSummary
from guidefield.messages.requests import ReadRobot


def _text(shown: RenderableType, width: int = 200) -> str:
    out = io.StringIO()
    Console(file=out, width=width).print(shown)
    return out.getvalue()


def test_a_robot_has_a_line_beside_its_variants_and_those_that_cannot_be_used_their_reason() -> None:
    groups = ["a", "b", "c", "d", "e", "f"]
    kinds = {"revolute": 5, "planar": 1}
    arm = RobotSummary(name="arm", source="x", family="arm", dof=8, joint_kinds=kinds, mimics=2, tip="tool0")
    robots = [
        arm,
        RobotSummary(name="broken", source="x", family="broken", problem="joint 'j' has a zero axis"),
        RobotSummary(name="cart", source="x", family="cart", dof=3, joint_kinds={"planar": 1}, groups=groups, tip="t"),
        RobotSummary(name="small_arm", source="x", family="arm", dof=0, tip="tool0"),
    ]
    lines = [line.strip() for line in _text(robots_table(RobotsReply(robots=robots))).splitlines()]
    assert [line.split()[0] for line in lines if line.startswith(("arm", "small_arm", "cart"))] == [
        "arm",
        "small_arm",
        "cart",
    ]
    assert "\n  small_arm " in _text(robots_table(RobotsReply(robots=robots)), width=40)
    assert "and 2 more" not in _text(robots_table(RobotsReply(robots=robots), narrow=True))
    text = "\n".join(lines)
    assert "8     5 revolute, 1 planar, 2 that follow" in text
    assert "a, b, c, d and 2 more" in text
    assert "broken: joint 'j' has a zero axis" in text


def test_all_about_one_robot() -> None:
    reply = answer(ReadRobot("panda"))
    assert isinstance(reply, RobotReply)
    text = _text(robot_table(reply))
    for told in (
        "tip panda_hand_tcp",
        "9 convex hull, 8 primitive",
        "panda_joint4",
        "-3.072 … -0.0698",
        "2.175 (urdf)",
        "12.5 (card)",
        "prismatic, = panda_finger_joint1",
        "SRDF: Adjacent",
        "20 pairs of links are tested",
        "the SRDF disables panda_hand and panda_link5",
    ):
        assert told in text, told
