"""A load is carried slowly enough over a real session: planned, judged again, refused where more is asked for."""

from __future__ import annotations

import pytest

from guidefield import Client, MalformedRequest, Piece

START = {"panda_joint2": -0.785398, "panda_joint4": -2.0, "panda_joint6": 1.570796}
GOAL = {"type": "joints", "positions": {"panda_joint1": 1.0, "panda_joint4": -1.7}}
BALL = {"type": "sphere", "name": "load", "radius": 0.02, "position": [0, 0, 0.05]}
FINGERS = ["panda_leftfinger", "panda_rightfinger"]
HELD = [{"obstacle": BALL, "link": "panda_hand", "touch_links": FINGERS, "mass": 3.0, "centre_of_mass": [0, 0, 0.05]}]
CARRY = {"robot": "panda", "scene": "table", "start": START, "attached_objects": HELD, "recording": "off"}
SLOWLY = [{"frame": "panda_hand_tcp", "speed": 0.25}, {"link": "load", "speed": 0.3}]


def test_a_load_is_carried_within_limits_of_speed_and_torque(client: Client) -> None:
    asked = {**CARRY, "cartesian_limits": SLOWLY, "limits": {"panda_joint1": {"effort": 5.0}}}
    made = client.plan(**asked, goal=GOAL, guide_planes=[])
    assert made.status.name == "SUCCESS", made.status
    assert [use.speed <= use.speed_limit for use in made.cartesian] == [True, True]
    first, second = made.effort.joints[:2]
    assert first.limit == 5.0
    assert first.share <= 1.0
    assert second.effort > 20.0, "the arm and 3 kg weigh"
    motion = {"trajectory": made.trajectory, "position_names": made.position_names}
    same = client.certify(**asked, **motion)
    assert same.status.name == "SUCCESS", same.status
    assert same.cartesian == made.cartesian
    assert same.effort == made.effort
    faster = client.certify(**{**asked, "cartesian_limits": [{"frame": "panda_hand_tcp", "speed": 0.2}]}, **motion)
    assert "frame 'panda_hand_tcp' reaches 0.2" in faster.status.message
    assert client.run(made.run_id).reply == made


def test_a_stream_keeps_a_speed_in_space(client: Client) -> None:
    goal = {"type": "joints", "positions": {"shoulder_pan_joint": 1.0}}
    asked = {"robot": "ur5", "scene": "table", "goal": goal, "start": {"shoulder_lift_joint": -1.5}, "recording": "off"}
    with client.stream(**asked, cartesian_limits=[{"frame": "tool0", "speed": 0.2}]) as stream:
        stream.update()
        piece = stream.answer(within=5.0)
    assert isinstance(piece, Piece)
    assert piece.leads_to == "goal"
    hard = [{"frame": "tool0", "speed": 0.2, "acceleration": 1.0}]
    with pytest.raises(MalformedRequest, match="limits of acceleration in space"):
        client.stream(**asked, cartesian_limits=hard).__enter__()


def test_a_load_that_is_too_heavy_is_refused_with_the_joint(client: Client) -> None:
    heavy = {**CARRY, "limits": {"panda_joint4": {"effort": 15.0}}}
    refused = client.plan(**heavy, goal=GOAL, guide_planes=[])
    assert refused.status.name == "START_STATE_INVALID"
    assert refused.status.details["joint"] == "panda_joint4"
    with pytest.raises(MalformedRequest, match="give a `frame` or a `link`, got both"):
        client.plan(**CARRY, goal=GOAL, cartesian_limits=[{"frame": "panda_hand", "link": "load", "speed": 1.0}])
