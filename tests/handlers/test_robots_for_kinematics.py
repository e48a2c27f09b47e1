"""Robots without collision geometry or with a tip that nothing drives; what is said about a robot's shapes."""

import math
from typing import Any

import pytest

from guidefield.engine import answer
from guidefield.errors import InvalidGroup, RobotInvalid
from guidefield.handlers.robots import robot as described
from guidefield.robot.link_bounds import convex_parts, coverage
from tests.robots import robot

LIMIT = '<limit lower="{}" upper="{}" velocity="0.5" effort="1"/>'
BARE = (
    '<robot name="bare"><link name="w"/><link name="b"/><link name="tool"/><joint name="j" type="revolute">'
    f'<parent link="w"/><child link="b"/><axis xyz="0 0 1"/>{LIMIT.format(-1, 1)}</joint><joint name="f" type="fixed">'
    '<origin xyz="1 0 0"/><parent link="b"/><child link="tool"/></joint></robot>'
)
EMPTY = {"name": "empty", "obstacles": []}
POSE = {"position": [math.cos(0.5), math.sin(0.5), 0.0], "quaternion_xyzw": [0.0, 0.0, math.sin(0.25), math.cos(0.25)]}
GOAL = {"type": "joints", "positions": {"j": 0.3}}


def of(text: str) -> dict[str, str]:
    return {"type": "urdf", "text": text}


def test_kinematics_are_answered_with_a_warning() -> None:
    placed = answer(
        {"type": "forward_kinematics", "robot": of(BARE), "configurations": [{"j": 0.5}], "frames": ["tool"]}
    )
    assert placed.placements[0][0].position == pytest.approx(POSE["position"])
    assert "has no collision geometry" in placed.warnings[0]
    found = answer({"type": "inverse_kinematics", "robot": of(BARE), "poses": [POSE]})
    assert found.configurations[0][0]["j"] == pytest.approx(0.5)
    assert "has no collision geometry" in found.warnings[0]
    assert answer({"type": "robot", "robot": of(BARE)}).geometry == []


@pytest.mark.parametrize(
    "asked",
    [
        {"goal": GOAL},
        {"goal": {"type": "pose", **POSE}},
        {"steps": [{"goal": GOAL}, {"goal": GOAL}]},
        {"type": "certify", "path": [[0.0], [0.5]], "position_names": ["j"]},
        {"type": "clearance", "configurations": [{"j": 0.5}]},
        {"type": "potential", "configurations": [{"j": 0.5}]},
        {"type": "inverse_kinematics", "poses": [POSE], "collision_free": True},
    ],
    ids=str,
)
def test_what_is_about_collisions_is_refused(asked: dict[str, Any]) -> None:
    with pytest.raises(RobotInvalid, match="has no collision geometry, so nothing can be said about collisions"):
        answer({"robot": of(BARE), "scene": EMPTY, **asked})


FINGER = '<collision><origin xyz="0 0 0.02"/><geometry><box size="0.01 0.01 0.04"/></geometry></collision>'


def gripper(follow: str, limits: tuple[float, float] = (0.0, 0.8)) -> dict[str, str]:
    """Two fingers, of which the second is the default tip; `follow` is its joint's type and what it has in it."""
    kind, _, inside = follow.partition(" ")
    return of(
        f'<robot name="g"><link name="palm"/><link name="left">{FINGER}</link><link name="right">{FINGER}</link>'
        '<joint name="drive" type="revolute"><origin xyz="0.03 0 0.05"/><parent link="palm"/><child link="left"/>'
        f'<axis xyz="0 -1 0"/>{LIMIT.format(*limits)}</joint>'
        f'<joint name="follow" type="{kind}"><origin xyz="-0.03 0 0.05"/><parent link="palm"/><child link="right"/>'
        f'<axis xyz="0 -1 0"/>{inside}</joint></robot>'
    )


@pytest.mark.parametrize(
    "follow",
    [f'revolute {LIMIT.format(-0.8, 0)}<mimic joint="drive" multiplier="-1"/>', f"revolute {LIMIT.format(0, 0)}"],
    ids=["a mimic joint", "a joint that can't move"],
)
def test_what_moves_is_planned_for_where_the_tip_is_on(follow: str) -> None:
    goal = {"type": "joints", "positions": {"drive": 0.5}}
    reply = answer({"robot": gripper(follow), "scene": EMPTY, "goal": goal})
    assert reply.status.name == "SUCCESS"
    assert reply.position_names == ["drive"]
    assert reply.trajectory.positions[-1] == pytest.approx([0.5])


def test_a_tip_that_a_request_names_has_to_move() -> None:
    goal = {"type": "joints", "positions": {"drive": 0.5}}
    with pytest.raises(InvalidGroup, match=r"no joint moves 'palm'.*`group` may name some of drive"):
        answer({"robot": gripper(f"revolute {LIMIT.format(0, 0)}"), "scene": EMPTY, "tip": "palm", "goal": goal})


def test_a_robot_without_joints_says_so() -> None:
    text = f'<robot name="g"><link name="palm">{FINGER}</link></robot>'
    with pytest.raises(InvalidGroup, match="no joint of the robot can move"):
        answer({"robot": of(text), "scene": EMPTY, "goal": {"type": "joints", "positions": {}}})


def test_shapes_come_with_their_cover_and_parts() -> None:
    model = robot("ur5")
    covered, cut = coverage(model), convex_parts(model)
    reply = described(model)
    assert [shape.name for shape in reply.geometry] == [choice.name for choice in model.geometry_choices]
    for shape, balls, found in zip(reply.geometry, covered.shapes, cut, strict=True):
        assert (shape.cover.spheres, shape.cover.inner_balls) == (len(balls.cover.spheres), len(balls.inner))
        assert shape.cover.overhang == balls.cover.overhang <= covered.delta
        assert (shape.parts is None) == (found is None) == (shape.judged_as != "triangle mesh")
        if shape.parts is not None and found is not None:
            assert shape.parts.count == len(found.parts)
            assert shape.parts.stand_off == max(part.stand_off for part in found.parts)
