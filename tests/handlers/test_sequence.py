"""Plans with steps: the kitchen's pick and place, looked at again with a bare robot, and what is refused."""

import json
import time
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pinocchio as pin
import pytest
from msgspec import to_builtins

from guidefield import run_arrays
from guidefield.engine import answer
from guidefield.errors import (
    InvalidConfiguration,
    InvalidGoal,
    InvalidGroup,
    MalformedRequest,
    UnknownFrame,
    UnknownObject,
)
from guidefield.handlers.sequence import answer_steps
from guidefield.messages import codec, scene as messages
from guidefield.messages.replies import PlanReply
from guidefield.messages.requests import UrdfText
from guidefield.scene.scene import build
from guidefield.stores import scenes
from tests.examples import example
from tests.handlers.motions import Bare, distance, frames_along, states
from tests.handlers.test_plan import PATIENT, READY
from tests.robots import box_arm, load, robot

FINGERS = ["panda_leftfinger", "panda_rightfinger"]
GRASP, CLOSE, LIFT, BACK, DOWN, OPEN = 1, 2, 3, 4, 6, 7  # steps of the kitchen's request


def ask(
    steps: list[dict[str, Any]], arm: str | UrdfText = "panda", scene: str | dict[str, Any] = "kitchen", **fields: Any
) -> PlanReply:
    named = arm if isinstance(arm, str) else to_builtins(arm)
    request = codec.decode_request({"robot": named, "scene": scene, "steps": steps, **PATIENT, **fields})
    loaded = robot(arm) if isinstance(arm, str) else load(arm)
    among = scenes.read_packaged(request.scene) if isinstance(request.scene, str) else request.scene
    return answer_steps(request, loaded, build(among), run_id="r", received=time.monotonic())


def joints(**positions: float) -> dict[str, Any]:
    return {"goal": {"type": "joints", "positions": positions}}


def relative(*position: float, frame: str = "tip") -> dict[str, Any]:
    return {"goal": {"type": "relative", "position": position, "frame": frame}, "linear": True}


@pytest.fixture(scope="module")
def kitchen() -> PlanReply:
    request = json.loads(example("kitchen"))
    reply = ask(request["steps"], start=request["start"])
    assert reply.status.name == "SUCCESS", reply.status.message
    return reply


def held_since(reply: PlanReply) -> Any:
    """Placement of the can in the hand."""
    bare, can = Bare(reply.position_names), build(scenes.read_packaged("kitchen")).obstacle("can")
    bare.stand(states(reply, np.array([reply.steps[GRASP].end]))[0])
    return bare.frame("panda_hand").actInv(can.placement)


def test_the_can_is_on_the_table_in_the_end(kitchen: PlanReply) -> None:
    bare = Bare(kitchen.position_names)
    bare.stand(states(kitchen, np.array([kitchen.steps[OPEN].end]))[0])
    put = bare.frame("panda_hand") * held_since(kitchen)
    np.testing.assert_allclose(put.rotation[:, 2], (0.0, 0.0, 1.0), atol=2e-3)
    assert put.translation[2] == pytest.approx(0.30 + 0.06, abs=1e-3)
    assert np.hypot(*(put.translation[:2] - (0.36, 0.5))) < 2e-3
    assert [step.held for step in kitchen.steps] == [[], [], *[["can"]] * 6, [], []]
    assert (kitchen.steps[GRASP].attached, kitchen.steps[OPEN].detached) == ("can", "can")


def test_nothing_touches_but_what_may(kitchen: PlanReply) -> None:
    """Everything once more by Coal, at samples: the bare robot, and the can where the hand or somebody put it."""
    bare, scene, in_hand = Bare(kitchen.position_names), build(scenes.read_packaged("kitchen")), held_since(kitchen)
    can, others = scene.obstacle("can"), [one for one in scene.obstacles if one.name != "can"]
    standing = can.placement
    for step in kitchen.steps:
        for moment in np.linspace(step.begin, step.end, 8):
            bare.stand(states(kitchen, np.array([moment]))[0])
            placed = bare.frame("panda_hand") * in_hand if step.held else standing
            may = {one.obstacle for one in step.permissions if one.begin <= moment <= one.end}
            for link, shape, there in bare.bodies():
                assert all(distance(shape, there, one.shape, one.placement) > 0.0 for one in others), link
                if link not in ("panda_hand", "panda_link7", *FINGERS) or not step.held:
                    assert distance(shape, there, can.shape, placed) > 0.0, link
            for one in others:
                if step.held and one.name not in may:
                    assert distance(can.shape, placed, one.shape, one.placement) > 0.0, one.name
        if step.held:
            standing = placed


def test_the_permissions_end_where_the_can_is_away(kitchen: PlanReply) -> None:
    bare, scene, in_hand = Bare(kitchen.position_names), build(scenes.read_packaged("kitchen")), held_since(kitchen)
    can = scene.obstacle("can")
    told = [(step, one) for step in kitchen.steps for one in step.permissions]
    assert [(one.object, one.obstacle) for _, one in told] == [("can", "board2")] * 2 + [("can", "table_top")] * 2
    for moment, name in ((told[1][1].end, "board2"), (told[2][1].begin, "table_top")):
        against = scene.obstacle(name)
        bare.stand(states(kitchen, np.array([moment]))[0])
        gap = distance(can.shape, bare.frame("panda_hand") * in_hand, against.shape, against.placement)
        assert 5e-3 <= gap < 8e-3
    assert told[0][1].begin == kitchen.steps[GRASP].end
    assert told[-1][1].end == kitchen.steps[OPEN].end


def test_straight_steps_are_straight(kitchen: PlanReply) -> None:
    for index in (GRASP, LIFT, BACK, DOWN):
        step = kitchen.steps[index]
        placed = frames_along(kitchen, "panda_hand_tcp", np.linspace(step.begin, step.end, 60))
        first, last = placed[0], placed[-1]
        offset = last.translation - first.translation
        along = offset / np.linalg.norm(offset)
        for one in placed:
            aside = np.cross(one.translation - first.translation, along)
            assert np.linalg.norm(aside) < 1e-3
            assert np.linalg.norm(pin.log3(first.rotation.T @ one.rotation)) < 1e-2


def test_it_is_one_motion_that_rests_at_every_mark(kitchen: PlanReply) -> None:
    trajectory = kitchen.trajectory
    assert kitchen.position_names == [*(f"panda_joint{i}" for i in range(1, 8)), "panda_finger_joint1"]
    assert kitchen.steps[0].begin == 0.0
    assert [a.end for a in kitchen.steps[:-1]] == [b.begin for b in kitchen.steps[1:]]
    assert kitchen.steps[-1].end == trajectory.times[-1]
    velocities = np.array(trajectory.velocities)
    for step in kitchen.steps:
        assert np.abs(velocities[trajectory.times.index(step.end)]).max() == 0.0
    arm, hand = velocities[:, :7], velocities[:, 7]
    opening = [i for i, t in enumerate(trajectory.times) if kitchen.steps[CLOSE].begin <= t <= kitchen.steps[CLOSE].end]
    assert np.abs(arm[opening]).max() == 0.0
    assert np.abs(hand[opening]).max() > 0.0
    waits = states(kitchen, kitchen.steps[CLOSE].end - np.array([0.19, 0.1, 0.0]))
    assert np.ptp(waits, axis=0).max() < 1e-12


def test_limits_are_kept_all_along(kitchen: PlanReply) -> None:
    times = np.linspace(0.0, kitchen.steps[-1].end, 4001)
    rows, h = states(kitchen, times), 1e-5
    speeds = (states(kitchen, times[1:-1] + h) - states(kitchen, times[1:-1] - h)) / (2 * h)
    joints_of = [robot("panda").joint(name) for name in kitchen.position_names]
    for column, joint in enumerate(joints_of):
        assert (rows[:, column] >= joint.lower[0] - 1e-9).all()
        assert (rows[:, column] <= joint.upper[0] + 1e-9).all()
        assert np.abs(speeds[:, column]).max() <= joint.velocity[0] * (1 + 1e-6)


def test_the_figures_of_the_whole_are_those_of_its_steps(kitchen: PlanReply) -> None:
    assert kitchen.certificate.collision_free
    assert kitchen.certificate.covers == "trajectory"
    assert all(step.certificate.collision_free for step in kitchen.steps)
    figures = [step.clearance for step in kitchen.steps if step.clearance is not None]
    assert kitchen.clearance.minimum == min(one.minimum for one in figures if one.minimum is not None)
    assert 0.0 <= kitchen.clearance.time <= kitchen.steps[-1].end
    assert codec.encode(kitchen)


def test_a_step_has_its_own_scaling() -> None:
    slow = ask([joints(panda_joint1=0.4) | {"max_velocity_scaling_factor": 0.1}, joints(panda_joint1=0.0)])
    first, second = slow.steps
    assert first.end > 3.0 * (second.end - second.begin)


def test_a_failure_names_its_step() -> None:
    reply = ask([joints(panda_joint1=0.4), relative(0.0, 0.0, 2.0)])
    assert reply.status.name == "NO_IK_SOLUTION"
    assert reply.status.message.startswith("`steps[1]`: the tip can't go straight")
    assert reply.status.details["step"] == 1
    assert reply.status.details["path"] == "$.steps[1]"
    assert reply.trajectory is None
    assert reply.steps == []
    assert reply.certificate.covers == "path"
    assert reply.path[0][0] == pytest.approx(0.4)


@pytest.mark.parametrize("first", [joints(panda_joint1=0.4), relative(0.0, 0.0, 0.05)])
def test_time_is_minded_however_many_steps_there_are(first: dict[str, Any]) -> None:
    reply = ask([first, *[joints(panda_joint1=0.1 * (k % 2)) for k in range(199)]], allowed_planning_time=1e-3)
    assert reply.status.name == "TIMED_OUT", reply.status.message
    assert reply.status.details["step"] <= 1
    assert reply.trajectory is None
    with pytest.raises(MalformedRequest, match="<= 200"):
        ask([first] * 201)


def test_a_held_object_may_not_come_back_where_it_was_taken_from() -> None:
    """Lifted by 2 cm and lowered again, without being put down there: the second contact is refused."""
    take = {"object": "can", "touch_links": FINGERS, "touch_objects": ["board2"]}
    request = json.loads(example("kitchen"))
    up, down = relative(0.0, 0.0, 0.02, frame="world"), relative(0.0, 0.0, -0.02, frame="world")
    steps = [request["steps"][0], request["steps"][1] | {"attach": take}, up, down, joints(panda_finger_joint1=0.04)]
    steps[-1]["group"] = "hand"
    reply = ask(steps, start=request["start"])
    assert reply.status.name == "INVALID_MOTION_PLAN"
    assert reply.status.details["step"] == 3
    assert set(reply.status.details["pair"]) == {"can", "board2"}
    put = ask([*steps[:-1], steps[-1] | {"detach": "can"}], start=request["start"])
    assert put.status.name == "SUCCESS", put.status.message


def test_a_grasp_that_leaves_no_way_on_is_not_chosen() -> None:
    """Of two configurations the nearer one is stretched out, so that the tip can't go on."""
    folded = {"shoulder_lift_joint": -1.57, "wrist_1_joint": -1.57, "wrist_2_joint": -1.57}
    near, nearer, far = ({**folded, "elbow_joint": elbow} for elbow in (0.1, 0.2, 1.6))
    up = relative(0.0, 0.0, 0.2, frame="world")

    def elbow_after(goals: list[dict[str, float]], *then: dict[str, Any]) -> tuple[PlanReply, float | None]:
        steps = [{"goal": {"type": "joint_set", "positions": goals}}, *then]
        reply = ask(steps, "ur5", {"name": "empty"}, start={**folded, "elbow_joint": 0.4})
        if reply.trajectory is None:
            return reply, None
        at = reply.trajectory.times.index(reply.steps[0].end)
        return reply, reply.trajectory.positions[at][reply.position_names.index("elbow_joint")]

    assert elbow_after([nearer, far])[1] == pytest.approx(0.2)
    assert elbow_after([nearer, far], up)[1] == pytest.approx(1.6)
    refused, _ = elbow_after([near, nearer], up)
    assert refused.status.name == "NO_IK_SOLUTION"
    assert (refused.status.details["step"], refused.status.details["chosen_by"]) == (1, 0)


TAKE = {"attach": {"object": "can"}}
PASS = {"stop": False}


@pytest.mark.parametrize(
    ("steps", "kind", "path", "says"),
    [
        ([{}], MalformedRequest, "$.steps[0]", "must have a `goal`"),
        ([joints() | {"start_velocities": {}}], MalformedRequest, "$.steps[0]", "unknown field"),
        ([joints(), joints() | PASS], MalformedRequest, "$.steps[1]", "needs a step after it: the last one"),
        ([joints() | PASS, {"pause": 1.0}, joints()], MalformedRequest, "$.steps[0]", "that one has no `goal`"),
        ([joints() | PASS, joints() | {"group": "hand"}], MalformedRequest, "$.steps[0]", "moves the same joints"),
        (
            [joints(), {"pause": 1.0} | PASS, joints()],
            MalformedRequest,
            "$.steps[1].stop",
            "`stop: false` needs a `goal`",
        ),
        ([joints() | PASS | {"pause": 0.1}, joints()], MalformedRequest, "$.steps[0].stop", "goes without `pause`"),
        ([joints() | PASS | {"detach": "can"}, joints()], MalformedRequest, "$.steps[0].stop", "goes without `detach`"),
        ([joints() | PASS | TAKE, joints()], MalformedRequest, "$.steps[0].stop", "goes without `attach`"),
        (
            [{"goal": {"type": "guide_plane"}} | PASS, joints()],
            MalformedRequest,
            "$.steps[0].stop",
            "of joints or a pose",
        ),
        ([joints() | {"radius": 0.0}, joints()], MalformedRequest, "$.steps[0].radius", "> 0.0"),
        ([joints() | {"linear": True}], MalformedRequest, "$.steps[0].linear", "`linear` needs a `goal` of type"),
        ([joints(), joints(elbow=1.0)], InvalidGoal, "$.steps[1].goal.positions.elbow", "no joint 'elbow'"),
        ([joints() | {"group": "legs"}], InvalidGroup, "$.steps[0]", "legs"),
        ([joints(), joints() | {"tip": "nose"}], UnknownFrame, "$.steps[1].tip", "nose"),
        (
            [joints() | TAKE, joints() | TAKE],
            UnknownObject,
            "$.steps[1].attach",
            "the scene has no obstacle 'can' then",
        ),
        ([joints() | {"attach": {"object": "floor"}}], MalformedRequest, "$.steps[0].attach", "half_space"),
        ([joints() | {"attach": {"object": "can", "link": "paw"}}], UnknownFrame, "$.steps[0].attach", "paw"),
        ([joints() | {"attach": {"object": "can", "touch_objects": ["x"]}}], UnknownObject, "$.steps[0].attach", "'x'"),
        ([joints() | {"detach": "can"}], UnknownObject, "$.steps[0].detach", "'can' is not held"),
        ([{"pause": 1.0}], MalformedRequest, "$.steps", "nothing moves"),
        ([joints() | {"pause": -1.0}], MalformedRequest, "$.steps[0].pause", ">= 0.0"),
        ([joints() | {"radii": 0.1}], MalformedRequest, "$.steps[0]", "unknown field `radii`"),
    ],
)
def test_a_step_that_is_wrong_is_named(steps, kind, path, says):
    with pytest.raises(kind) as refused:
        ask(steps)
    assert refused.value.details["path"] == path
    assert says in refused.value.message


def test_steps_are_planned_from_when_they_begin_among_what_moves_by_itself(tmp_path: Path) -> None:
    """The robot waits for a door, goes straight behind it, and comes back by a bar that slides away later."""
    places = [{"position": (0.85, 0.0, 0.8)}, {"position": (2.6, 0.0, 0.8)}]
    slides = {"times": [2.0, 3.0], "placements": places}
    door = {"type": "box", "name": "door", "size": [1.4, 0.05, 1.6], "trajectory": slides}
    bar = {"type": "box", "name": "bar", "size": [0.1, 0.1, 2.0], "trajectory": slides | {"times": [3.5, 5.5]}}
    left, right = ({"panda_joint1": turn, "panda_joint2": -0.585, "panda_joint4": -2.156} for turn in (0.8, -0.8))
    steps = [joints(**right) | {"pause": 0.2}, relative(0.0, 0.0, -0.05, frame="world"), joints(**left)]
    scene = {"name": "s", "obstacles": [door, bar]}
    asked = {"robot": "panda", "scene": scene, "start": READY | left, "steps": steps, **PATIENT}
    reply = answer(asked, record_to=tmp_path / "run.rrd")
    assert reply.status.name == "SUCCESS", reply.status.message
    assert reply.certificate.collision_free
    assert 2.0 < reply.steps[0].end < 5.0
    among = build(msgspec.convert(scene, messages.Scene))
    bare, times = Bare(reply.position_names), np.linspace(0.0, reply.trajectory.times[-1], 200)
    for now, row in zip(times.tolist(), states(reply, times), strict=True):
        bare.stand(row)
        for there in among.at(now).obstacles:
            assert all(distance(shape, at, there.shape, there.placement) > 0.0 for _, shape, at in bare.bodies())
    begin, end = reply.steps[1].begin, reply.steps[1].end
    places = [one.translation for one in frames_along(reply, "panda_hand", np.linspace(begin, end, 20))]
    np.testing.assert_allclose(np.array(places)[:, :2], np.tile(places[0][:2], (20, 1)), atol=2e-3)
    assert places[-1][2] - places[0][2] == pytest.approx(-0.05, abs=1e-4)
    recorded = run_arrays(tmp_path / "run.rrd")
    np.testing.assert_allclose(recorded.times, reply.trajectory.times)


def test_what_moves_is_picked_up_where_it_comes_to_rest_and_put_down_on_what_moves() -> None:
    """The can slides out between the fingers on its board; the table comes later, and goes on after that."""
    request, declared = json.loads(example("kitchen")), to_builtins(scenes.read_packaged("kitchen"))
    shelf, arrives = [{"position": [0.08, 0.0, 0.0]}, {"position": [0.0, 0.0, 0.0]}], [3.0, 6.0]
    table = [{"position": [0.0, 0.3, 0.0]}, {"position": [0.0, 0.0, 0.0]}]
    slides = dict.fromkeys(("can", "board2"), ([2.0, 5.0], shelf)) | {"table_top": (arrives, table)}
    for one in declared["obstacles"]:
        if one["name"] in slides:
            times, offsets = slides[one["name"]]
            places = [{"position": np.add(one["position"], offset["position"]).tolist()} for offset in offsets]
            one["trajectory"] = {"times": times, "placements": places}
    reply = ask(request["steps"], scene=declared, start=request["start"])
    assert reply.status.name == "SUCCESS", reply.status.message
    assert reply.certificate.collision_free
    assert reply.steps[GRASP].end == 5.0
    assert [one.obstacle for step in reply.steps for one in step.permissions] == ["board2"] * 2 + ["table_top"] * 2
    scene, bare = build(msgspec.convert(declared, messages.Scene)), Bare(reply.position_names)
    can = scene.obstacle("can")
    bare.stand(states(reply, np.array([5.0]))[0])
    in_hand, put = bare.frame("panda_hand").actInv(can.placement_at(5.0)), reply.steps[OPEN].end
    for step in reply.steps:
        for now in np.linspace(step.begin, step.end, 12).tolist():
            bare.stand(states(reply, np.array([now]))[0])
            held = bare.frame("panda_hand") * in_hand
            placed = can.placement_at(now) if now <= 5.0 else held if now <= put else None
            may = {one.obstacle for one in step.permissions if one.begin <= now <= one.end}
            for one in (one for one in scene.obstacles if one.name != "can"):
                there = one.placement_at(now)
                assert all(distance(shape, at, one.shape, there) > 0.0 for _, shape, at in bare.bodies()), one.name
                if step.held and one.name not in may:
                    assert distance(can.shape, held, one.shape, there) > 0.0, one.name
            fingers = () if now <= 5.0 else ("panda_hand", "panda_link7", *FINGERS)
            if placed is not None:
                apart = [
                    distance(shape, at, can.shape, placed) for link, shape, at in bare.bodies() if link not in fingers
                ]
                assert min(apart) > 0.0


def test_a_later_step_tells_times_of_the_request() -> None:
    """A box comes to rest where the second step would end."""
    ends = {"times": [3.0, 5.0], "placements": [{"position": (2.0, 0.5, 0.5)}, {"position": (0.25, 0.25, 0.6)}]}
    box = {"type": "box", "name": "box", "size": [0.2, 0.2, 0.2], "trajectory": ends}
    scene = {"name": "s", "obstacles": [box]}
    reply = ask([joints(panda_joint1=-0.6) | {"pause": 2.0}, joints(panda_joint1=0.8)], scene=scene, start=READY)
    assert reply.status.name == "GOAL_IN_COLLISION", reply.status.message
    assert "`steps[1]`: as the obstacles stand from 5.00 s on: the goal is in collision" in reply.status.message
    assert reply.status.details["time"] == 5.0


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({"goal": {"type": "guide_plane"}}, "give a `goal` or `steps`, got both"),
        ({"steps": []}, "got neither"),
        ({"leave_start_contact": True}, "`leave_start_contact` is not served"),
        ({"guide_planes": "auto"}, "`guide_planes` are those of a step"),
    ],
)
def test_what_does_not_go_with_steps_is_named(fields: dict[str, Any], says: str) -> None:
    with pytest.raises(MalformedRequest) as refused:
        ask(**({"steps": [joints()]} | fields))
    assert says in refused.value.message


def test_limits_of_joints_that_no_step_moves_are_refused() -> None:
    with pytest.raises(InvalidConfiguration, match="panda_finger_joint1"):
        ask([joints(panda_joint1=0.1)], limits={"panda_finger_joint1": {"velocity": 0.1}})


def test_straight_lines_of_planar_joints_are_refused() -> None:
    with pytest.raises(MalformedRequest, match="`linear` is served for joints of one coordinate") as refused:
        ask([relative(0.1, 0.0, 0.0)], box_arm("planar y y", 3), {"name": "empty"})
    assert refused.value.details["path"] == "$.steps[0]"


def test_ball_joints_are_refused() -> None:
    with pytest.raises(InvalidGroup, match="spherical"):
        ask([joints()], "chain_fixed_6x300_r25", {"name": "empty"})
