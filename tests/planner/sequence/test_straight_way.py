"""Where a straight step ends that can't be followed, and what stops it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from guidefield.engine import answer
from guidefield.messages.replies import PlanReply

UR5 = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint")
TURN = {"type": "relative", "quaternion_xyzw": [0, 0, math.sin(0.25), math.cos(0.25)]}


def step(start: tuple[float, ...], goal: dict[str, Any]) -> PlanReply:
    asked = {"robot": "ur5", "scene": {"name": "e"}, "start": dict(zip(UR5, start, strict=True))}
    reply = answer({**asked, "steps": [{"goal": goal, "linear": True}]})
    assert isinstance(reply, PlanReply)
    return reply


@pytest.mark.parametrize("goal", [TURN, {**TURN, "frame": "world"}], ids=["tip", "world"])
def test_a_turn_that_a_limit_stops_names_joint_limit_and_share(goal: dict[str, Any]) -> None:
    upper = 6.28318530718
    # the tool looks straight down: about the world's z the last joint turns the other way
    begin = 6.0 if goal is TURN else -6.0
    reply = step((0.0, -1.57, 1.57, -1.57, -math.pi / 2, begin), goal)
    told, details = reply.status.message, reply.status.details
    assert reply.status.name == "NO_IK_SOLUTION"
    assert details["cause"] == "joint limit"
    assert (details["joint"], details["limits"]) == ("wrist_3_joint", [-upper, upper])
    assert "after 0.283 rad of a turn of 0.500 rad (56.6 %) wrist_3_joint reaches its limit of" in told
    assert details["share"] == pytest.approx((upper - 6.0) / 0.5, abs=1e-3 if goal is not TURN else 1e-8)
    assert abs(reply.path[-1][5]) == pytest.approx(upper, abs=1e-6)


def test_a_line_of_one_joint_ends_exactly_at_its_limit() -> None:
    """A slide along x whose limit is a third of the way: the share is that, in closed form."""
    box = '<collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision>'
    limit = '<limit lower="-0.1" upper="0.2" velocity="1" effort="1"/>'
    joint = (
        f'<joint name="slide" type="prismatic"><parent link="w"/><child link="a"/><axis xyz="1 0 0"/>{limit}</joint>'
    )
    text = f'<robot name="r"><link name="w"/><link name="a">{box}</link>{joint}</robot>'
    goal = {"type": "relative", "position": [0.3, 0, 0]}
    asked = {"robot": {"type": "urdf", "text": text}, "scene": {"name": "e"}, "start": {"slide": 0.1}}
    status = answer({**asked, "steps": [{"goal": goal, "linear": True}]}).status
    assert status.details["share"] == pytest.approx(1.0 / 3.0, abs=1e-8)
    assert status.details["share"] < 1.0
    assert status.message.endswith("mm along the straight way of 300.0 mm (33.3 %) slide reaches its limit of 0.2 m")


def test_a_line_just_beyond_reach_says_so_and_never_that_all_of_it_was_gone() -> None:
    goal = {"type": "relative", "frame": "world", "position": [0.100895, 0, 0]}
    reply = step((0.0, -0.5, 1.0, -0.5, -1.57, 0.0), goal)
    details = reply.status.details
    assert details["cause"] == "reach"
    assert 0.98 < details["share"] < 1.0
    assert (
        "99.8 mm along the straight way of 100.9 mm (99.0 %) the way leaves the robot's reach" in reply.status.message
    )
    last = np.array(reply.path[-1])
    assert abs(last[2]) < 0.05  # the elbow is all but stretched there
