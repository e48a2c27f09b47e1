"""Starts and goals as they are given: whole turns, goals next to the start, values next to a limit, held objects."""

import math
from typing import Any

import numpy as np
import pytest

from guidefield.engine import Engine, answer
from guidefield.errors import InvalidConfiguration
from guidefield.messages import codec
from guidefield.messages.replies import PlanReply
from guidefield.messages.streams import StreamOpen
from guidefield.stream.opening import StreamSetup, read_opening

LIMIT = '<limit lower="-1.5708" upper="1.5708" velocity="1" effort="1"/>'
EMPTY = {"name": "empty", "obstacles": []}
AWAY = {"times": [0, 2], "placements": [{"position": [0.3, -1.5, 0]}, {"position": [-0.3, -1.5, 0]}]}
MOVING = {"name": "m", "obstacles": [{"type": "sphere", "name": "s", "radius": 0.05, "trajectory": AWAY}]}
UPRIGHT = {"type": "orientation_cone", "frame": "a", "axis": [0, 0, 1], "target_axis": [0, 0, 1], "half_angle": 0.1}


def arm(kind: str, limit: str = "", **fields: Any) -> dict[str, Any]:
    bar = '<collision><origin xyz=".2 0 0"/><geometry><box size="0.4 0.02 0.02"/></geometry></collision>'
    joint = f'<parent link="w"/><child link="a"/><axis xyz="0 0 1"/>{limit}'
    links = f'<link name="w"/><link name="a">{bar}</link>'
    text = f'<robot name="r">{links}<joint name="j" type="{kind}">{joint}</joint></robot>'
    return {"type": "urdf", "text": text, **fields}


def to(value: float) -> dict[str, Any]:
    return {"type": "joints", "positions": {"j": value}}


def ask(start: Any, goal: dict[str, Any] | None, of: dict[str, Any], **fields: Any) -> PlanReply:
    start = start if isinstance(start, dict) else {"j": start}
    request = {"robot": of, "scene": EMPTY, "start": start, "goal": goal, **fields}
    return answer(request if "steps" in fields else {"guide_planes": [], **request})


def rows(reply: PlanReply) -> np.ndarray:
    assert reply.status.name == "SUCCESS", reply.status.message
    return np.array(reply.trajectory.positions)


TURNED: list[dict[str, Any]] = [
    {},
    {"start_velocities": {"j": 0.3}},
    {"optimization_iterations": 0},
    {"sample_rate": 20.0},
    {"scene": MOVING},
    {"scene": MOVING, "start_velocities": {"j": 0.3}},
]


@pytest.mark.parametrize("fields", TURNED)
@pytest.mark.parametrize(("start", "goal", "end"), [(3.5, 3.6, 3.6), (-416.721, 3.0, 3.0 - 134 * math.pi)])
def test_a_motion_begins_where_a_continuous_joint_stands(start, goal, end, fields):
    reply = ask(start, to(goal), arm("continuous"), **fields)
    found = rows(reply)[:, 0]
    assert found[[0, -1]] == pytest.approx([start, end], abs=1e-11)
    assert np.abs(np.diff(found)).max() < 1.0
    assert [reply.path[0][0], reply.path[-1][0]] == pytest.approx([start, end], abs=1e-11)


def test_steps_go_on_from_turn_to_turn() -> None:
    found = rows(ask(20.0, None, arm("continuous"), steps=[{"goal": to(value)} for value in (21.5, 23.0, 24.5)]))
    assert found[[0, -1], 0] == pytest.approx([20.0, 24.5], abs=1e-12)
    assert np.abs(np.diff(found[:, 0])).max() < 1.0


def test_a_planar_root_keeps_its_turns() -> None:
    start = {"root_joint": [0.1, 0.2, -20.0], "j": 0.5}
    goal = {"type": "joints", "positions": {"root_joint": [0.5, 0.0, 0.0]}}
    reply = ask(start, goal, arm("continuous", root_joint="planar"), group=["root_joint"])
    assert rows(reply)[[0, -1]] == pytest.approx(np.array([[0.1, 0.2, -20.0], [0.5, 0.0, -6.0 * math.pi]]), abs=1e-12)


def opening(**fields: Any) -> StreamSetup:
    request: StreamOpen = codec.convert({"scene": EMPTY, **fields}, StreamOpen)
    engine = Engine()
    return read_opening(request, engine._load_robot(request.robot), engine._build_scene(request.scene))


def test_a_stream_stands_where_its_start_is() -> None:
    assert opening(robot=arm("continuous"), start={"j": 40.0}).start == pytest.approx([40.0], abs=1e-12)


NEXT_TO: dict[str, dict[str, Any]] = {
    "plain": {},
    "clearance": {"objective": "clearance"},
    "jerk": {"limits": {"j": {"jerk": 5.0}}},
    "cone": {"path_constraints": [UPRIGHT]},
    "moving": {"scene": MOVING},
    "tree": {"planner": "tree"},
}


@pytest.mark.parametrize("fields", NEXT_TO.values(), ids=NEXT_TO)
@pytest.mark.parametrize("away", [1e-16, -9e-10, 4e-9, -8.0 * math.pi])
@pytest.mark.parametrize("kind", ["revolute", "prismatic", "continuous"])
def test_a_goal_a_hair_from_the_start_is_reached_at_once(kind: str, away: float, fields: dict[str, Any]) -> None:
    if abs(away) > 1.0 and kind != "continuous":
        return
    start = 0.5 + away
    many = {"type": "joint_set", "positions": [{"j": 0.5}, {"j": 1.2}]}
    for goal in (to(0.5), many):
        reply = ask(start, goal, arm(kind, LIMIT), **fields)
        assert rows(reply)[[0, -1], 0] == pytest.approx([start, start], abs=5e-9)
        assert reply.metrics.duration < 4e-3


def test_a_step_that_hardly_goes_anywhere_is_a_step() -> None:
    steps = [{"goal": to(0.5)}, {"goal": to(1.0)}, {"goal": to(1.0 + 1e-12), "stop": False}, {"goal": to(0.4)}]
    assert rows(ask(0.5 + 1e-12, None, arm("revolute", LIMIT), steps=steps))[-1, 0] == pytest.approx(0.4)


@pytest.mark.parametrize("objective", ["balanced", "time", "clearance"])
def test_a_tip_that_is_at_its_goal_already_stays(objective: str) -> None:
    start = {f"panda_joint{k}": v for k, v in enumerate((0.1, -0.6, 0.2, -2.1, 0.1, 1.7, 0.9), 1)}
    asked = {"type": "forward_kinematics", "robot": "panda", "frames": ["panda_hand"], "configurations": [start]}
    there = answer(asked).placements[0][0]
    goal = {"type": "pose", "position": there.position, "quaternion_xyzw": there.quaternion_xyzw}
    request = {"robot": "panda", "tip": "panda_hand", "scene": EMPTY, "start": start, "goal": goal}
    reply = answer({**request, "objective": objective, "guide_planes": []})
    assert len(rows(reply)) == 1


@pytest.mark.parametrize("limit", [1.5708, 0.0, -0.3, 2.7])
@pytest.mark.parametrize("beyond", [5e-6, 1e-5])
def test_what_is_slightly_beyond_a_limit_is_clamped_and_told(limit: float, beyond: float) -> None:
    of = arm("revolute", f'<limit lower="-2" upper="{limit}" velocity="1" effort="1"/>')
    over = limit + beyond
    told = f"j was {beyond:.2g} beyond its limit and was clamped"
    started, ended = ask(over, to(-1.0), of), ask(-1.0, to(over), of)
    assert (started.warnings, ended.warnings) == ([f"start {told}"], [f"goal {told}"])
    assert rows(ended)[-1, 0] == limit
    several = {"type": "joint_set", "positions": [{"j": over}, {"j": limit + 1e-6}]}
    assert ask(-1.0, several, of).warnings == [f"goal {told}"]
    steps = [{"goal": to(-0.9)}, {"goal": to(over)}]
    assert ask(-1.0, None, of, steps=steps).warnings == [f"step 1: goal {told}"]
    assert ask(-1.0, to(limit + 1.2e-5), of).status.name == "GOAL_STATE_INVALID"


FINGERS = ("panda_leftfinger", "panda_rightfinger")


def held(name: str, link: str, height: float, touch: tuple[str, ...] = ()) -> dict[str, Any]:
    can = {"type": "cylinder", "name": name, "radius": 0.04, "length": 0.2}
    return {"obstacle": can, "link": link, "placement": {"position": [0, 0, height]}, "touch_links": list(touch)}


IN_FINGERS = [held("can", "panda_hand", 0.2)]
TOUCHING = [held("can", "panda_hand", 0.2, FINGERS)]
TWO = [held("can", "panda_hand", 0.3, FINGERS), held("cup", "panda_leftfinger", 0.25, FINGERS)]


def verdicts(objects: list[dict[str, Any]], scene: dict[str, Any], **fields: Any) -> set[bool]:
    """What all doors say: whether nothing touches."""
    shared: dict[str, Any] = {"robot": "panda", "scene": scene, "attached_objects": objects, **fields}
    resting = {**shared, "scene": EMPTY}
    clear = answer({**resting, "type": "clearance", "configurations": [{}], "contacts": True})
    pose = {"position": [0.5, 0, 0.5], "quaternion_xyzw": [1, 0, 0, 0]}
    ik = answer({**resting, "type": "inverse_kinematics", "collision_free": True, "poses": [pose], "solutions": 1})
    found = {not clear.contacts[0], bool(ik.configurations[0])}
    goal = {"type": "joints", "positions": {"panda_joint1": 0.2}}
    for group in (None, "arm_and_hand"):
        reply = answer({**shared, "group": group, "goal": goal, "guide_planes": []})
        assert reply.status.name in ("SUCCESS", "START_STATE_IN_COLLISION")
        found.add(reply.status.name == "SUCCESS")
    motion = {"times": [0.0, 1.0], "positions": [[0.0], [0.2]]}
    judged = answer({**shared, "type": "certify", "trajectory": motion, "position_names": ["panda_joint1"]})
    found.add(judged.certificate.collision_free)
    found.add(answer({**shared, "steps": [{"goal": goal}]}).status.name == "SUCCESS")
    return found


@pytest.mark.parametrize("scene", [EMPTY, MOVING], ids=["resting", "moving"])
def test_every_door_says_the_same_of_what_a_held_object_touches(scene: dict[str, Any]) -> None:
    assert verdicts(IN_FINGERS, scene) == {False}
    assert verdicts(TWO, scene) == {False}
    assert verdicts(TOUCHING, scene) == {True}
    assert verdicts(IN_FINGERS, scene, allowed_collisions=[["can", one] for one in FINGERS]) == {True}


def test_a_plan_that_holds_something_in_its_fingers_names_pair_and_remedy() -> None:
    goal = {"type": "joints", "positions": {"panda_joint1": 0.2}}
    request = {"robot": "panda", "scene": EMPTY, "goal": goal, "guide_planes": [], "attached_objects": IN_FINGERS}
    reply = answer(request)
    assert reply.status.details["pair"] == ["panda_leftfinger", "can"]
    assert reply.status.details["depth"] == pytest.approx(0.0129, abs=1e-4)
    assert "`touch_links`" in reply.status.message


def test_a_stream_refuses_what_its_fingers_hold() -> None:
    with pytest.raises(InvalidConfiguration, match="'can' touches 'panda_leftfinger'"):
        opening(robot="panda", attached_objects=IN_FINGERS)
    assert not opening(robot="panda", attached_objects=TOUCHING).touching
