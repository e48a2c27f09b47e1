"""A ROS node's stand-in asks a real service as it would ask MoveIt, and sends it whatever comes."""

import json
import queue
import random
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import zenoh.ext

from tests.endpoint.ros.messages import (
    ARM,
    BENT,
    constraints,
    header,
    joint,
    offset,
    orientation,
    plan_request,
    pose,
    primitive,
    scene,
    thing,
    turned,
    within,
)
from tests.endpoint.ros.peer import ANSWERED_WITHIN, TYPES, Peer, key, new, peer_at
from tests.journeys.service import Service, await_that, running_service
from tests.robots import robot

TOOLS = Path(__file__).resolve().parent.parent.parent / "tools"
HEARD = {**BENT, "panda_finger_joint1": 0.02}
BALL = 2


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    with running_service(tmp_path_factory.mktemp("data"), "--workers", "1", "--ros", "--ros-domain", "3") as service:
        yield service


@pytest.fixture(scope="module")
def peer(service: Service) -> Iterator[Peer]:
    """A node that tells where the robot is; until that is heard."""
    with peer_at(service.endpoint, domain=3) as peer:
        joints = new("sensor_msgs/msg/JointState", name=list(HEARD), position=list(HEARD.values()))

        def heard() -> bool:
            peer.publish("joint_states", "sensor_msgs/msg/JointState", joints)
            told = peer.call("get_planning_scene", "GetPlanningScene").scene.robot_state.joint_state
            return HEARD.items() <= dict(zip(told.name, told.position.tolist(), strict=True)).items()

        await_that(heard)
        yield peer


def places(links: list[str], positions: dict[str, float]) -> list[Any]:
    """Where links are, by Pinocchio."""
    model = robot("panda").model
    data, q = model.createData(), pin.neutral(model)
    for name, value in positions.items():
        q[model.joints[model.getJointId(name)].idx_q] = value
    pin.framesForwardKinematics(model, data, q)
    bodies = {frame.name: index for index, frame in enumerate(model.frames) if frame.type == pin.BODY}
    return [data.oMf[bodies[link]].copy() for link in links]


def se3(stamped: Any) -> Any:
    at, turn = stamped.pose.position, stamped.pose.orientation
    return pin.XYZQUATToSE3(np.array([at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w]))


def test_the_graph_has_a_node_with_its_services_and_topics(peer: Peer):
    tokens = [str(one.ok.key_expr) for one in peer.session.liveliness().get("@ros2_lv/3/**")]
    kinds = sorted((token.split("/")[5], token.split("/")[9]) for token in tokens if "/NN/" not in token)
    assert kinds == [
        ("MP", "%display_planned_path"), ("MP", "%guidefield%plans"), ("MP", "%robot_description"),
        ("MS", "%joint_states"), ("MS", "%planning_scene"), ("SS", "%apply_planning_scene"),
        ("SS", "%check_state_validity"), ("SS", "%compute_fk"), ("SS", "%compute_ik"), ("SS", "%get_planning_scene"),
        ("SS", "%plan_kinematic_path"),
    ]  # fmt: skip
    assert sum("/0/0/NN/%/%/guidefield" in token for token in tokens) == 1
    assert len({token.split("/")[4] for token in tokens}) == len(tokens)


def test_a_plan_from_where_the_robot_is_heard_to_be(peer: Peer):
    shown = peer.listen("display_planned_path", "moveit_msgs/msg/DisplayTrajectory")
    told = peer.listen("guidefield/plans", "std_msgs/msg/String")
    goal = {name: value + 0.2 for name, value in BENT.items()}
    asked = plan_request(
        goal_constraints=[constraints([joint(name, value) for name, value in goal.items()])], allowed_planning_time=60.0
    )
    response = peer.call("plan_kinematic_path", "GetMotionPlan", motion_plan_request=asked.motion_plan_request)
    found = response.motion_plan_response
    assert (found.error_code.val, found.error_code.source, found.group_name) == (1, "guidefield", "arm")
    motion = found.trajectory.joint_trajectory
    assert motion.joint_names == ARM
    assert motion.points[0].positions.tolist() == pytest.approx(list(BENT.values()))
    assert motion.points[-1].positions.tolist() == pytest.approx(list(goal.values()))
    assert shown.get(timeout=ANSWERED_WITHIN).trajectory[0].joint_trajectory.points[-1].positions.tolist() == (
        motion.points[-1].positions.tolist()
    )
    figures = json.loads(told.get(timeout=ANSWERED_WITHIN).data)
    assert figures["certificate"]["collision_free"] is True
    assert f"run {figures['run_id']}" in found.error_code.message
    assert figures["recording"].endswith(f"/runs/{figures['run_id']}/recording")


def test_any_one_of_several_regions_is_reached(peer: Peer):
    """The first is out of reach, a point before the hand is to be in the second."""
    asked = plan_request(
        goal_constraints=[
            constraints(
                [],
                [within("panda_hand", [primitive(BALL, 0.05)] * 2, [pose(3.0, 0.0, 0.4), pose(0.45, 0.1, 0.3)],
                        target_point_offset=offset(0.0, 0.0, 0.1))],
                [orientation("panda_hand", turned(1.0, 0.0, 0.0, 0.0), (0.1, 0.1, 0.1))],
            )
        ],
        allowed_planning_time=60.0,
    )  # fmt: skip
    found = peer.call("plan_kinematic_path", "GetMotionPlan", motion_plan_request=asked.motion_plan_request)
    found = found.motion_plan_response
    assert found.error_code.val == 1, found.error_code.message
    assert "of 2 goals" in found.error_code.message
    motion = found.trajectory.joint_trajectory
    end = dict(zip(motion.joint_names, motion.points[-1].positions.tolist(), strict=True))
    (hand,) = places(["panda_hand"], {**HEARD, **end})
    assert np.linalg.norm(hand.act(np.array([0.0, 0.0, 0.1])) - [0.45, 0.1, 0.3]) <= 0.05


def test_a_refusal_is_a_response_that_names_the_field(peer: Peer):
    asked = plan_request(goal_constraints=[constraints([joint("nobody", 0.0)])])
    code = peer.call("plan_kinematic_path", "GetMotionPlan", motion_plan_request=asked.motion_plan_request)
    code = code.motion_plan_response.error_code
    assert code.val == -16
    assert "goal_constraints[0].joint_constraints[0].joint_name" in code.message


def test_forward_and_inverse_kinematics_agree_with_pinocchio(peer: Peer):
    links = ["panda_hand", "panda_link5"]
    found = peer.call("compute_fk", "GetPositionFK", fk_link_names=links)
    assert (found.error_code.val, found.fk_link_names) == (1, links)
    for stamped, place in zip(found.pose_stamped, places(links, HEARD), strict=True):
        assert se3(stamped).isApprox(place, 1e-9)
        assert stamped.header.frame_id == "panda_link0"
    inside = peer.call("compute_fk", "GetPositionFK", fk_link_names=links[:1], header=header("panda_link5"))
    hand, elbow = places(links, HEARD)
    assert se3(inside.pose_stamped[0]).isApprox(elbow.inverse() * hand, 1e-9)
    asked = new(
        "moveit_msgs/msg/PositionIKRequest",
        group_name="arm",
        ik_link_name="panda_hand",
        avoid_collisions=True,
        pose_stamped=new("geometry_msgs/msg/PoseStamped", pose=pose(0.45, 0.1, 0.4, (1.0, 0.0, 0.0, 0.0))),
    )
    answer = peer.call("compute_ik", "GetPositionIK", ik_request=asked)
    assert answer.error_code.val == 1
    joints = answer.solution.joint_state
    (there,) = places(["panda_hand"], dict(zip(joints.name, joints.position.tolist(), strict=True)))
    assert there.isApprox(se3(asked.pose_stamped), 1e-5)
    asked.pose_stamped.pose.position.x = 3.0
    answer = peer.call("compute_ik", "GetPositionIK", ik_request=asked)
    assert answer.error_code.val == -31
    assert "out of reach" in answer.error_code.message
    asked.ik_link_name = ""
    assert "ik_link_name" in peer.call("compute_ik", "GetPositionIK", ik_request=asked).error_code.message


def test_the_scene_that_is_applied_and_published_is_what_counts(peer: Peer):
    assert peer.call("check_state_validity", "GetStateValidity", group_name="arm").valid
    (hand,) = places(["panda_hand"], HEARD)
    ball = thing("ball", [primitive(BALL, 0.05)], [pose(*hand.translation)])
    assert peer.call("apply_planning_scene", "ApplyPlanningScene", scene=scene(ball)).success
    found = peer.call("check_state_validity", "GetStateValidity", group_name="arm")
    assert not found.valid
    assert ("panda_hand", 0, "ball", 1) in [
        (one.contact_body_1, one.body_type_1, one.contact_body_2, one.body_type_2) for one in found.contacts
    ]
    asked = plan_request(allowed_planning_time=60.0).motion_plan_request
    planned = peer.call("plan_kinematic_path", "GetMotionPlan", motion_plan_request=asked)
    assert planned.motion_plan_response.error_code.val == -10
    gone = scene(thing("ball", operation=1))
    peer.publish("planning_scene", "moveit_msgs/msg/PlanningScene", gone)
    await_that(lambda: not peer.call("get_planning_scene", "GetPlanningScene").scene.world.collision_objects)
    assert not peer.call("apply_planning_scene", "ApplyPlanningScene", scene=gone).success


def test_the_robots_description_is_there_for_who_comes_later(peer: Peer):
    found: queue.Queue[Any] = queue.Queue()
    zenoh.ext.declare_advanced_subscriber(
        peer.session,
        key("robot_description", "std_msgs/msg/String", 3),
        found.put,
        history=zenoh.ext.HistoryConfig(detect_late_publishers=True),
    )
    urdf = TYPES.read(found.get(timeout=ANSWERED_WITHIN).payload.to_bytes(), "std_msgs/msg/String").data
    assert "<robot" in urdf
    assert str(Path.home()) not in urdf


def test_another_domain_and_another_hash_reach_nobody(peer: Peer):
    name = "moveit_msgs/srv/GetPositionFK"
    payload = TYPES.write(new(f"{name}_Request"), f"{name}_Request")
    for other in (key("compute_fk", name, 0), key("compute_fk", name, 3)[:-1] + "x"):
        assert list(peer.session.get(other, payload=payload, timeout=ANSWERED_WITHIN)) == []


def test_whatever_is_sent_gets_exactly_one_answer(peer: Peer, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.syspath_prepend(str(TOOLS))
    from attacks.ros_payloads import SERVICES, draw_payload

    rng, kinds = random.Random(5), set()
    for _ in range(150):
        sent = draw_payload(rng)
        service = SERVICES[sent.name].rpartition("/")[2]
        (reply,) = peer.replies(sent.name, service, sent.payload, sent.attachment or b"")
        try:
            TYPES.read(sent.payload, f"moveit_msgs/srv/{service}_Request")
            readable = True
        except ValueError:
            readable = False
        assert (reply.ok is not None) is readable
        kinds.add((sent.name, readable))
    assert len(kinds) == 2 * len(SERVICES)


def test_the_example_asks_without_ros(service: Service, peer: Peer, tmp_path: Path):
    assert peer.call("apply_planning_scene", "ApplyPlanningScene", scene=scene(diff=False)).success
    example = (TOOLS / "examples" / "ros2_stand_in.py").read_text().replace('GetMotionPlan", 0,', 'GetMotionPlan", 3,')
    (tmp_path / "asks.py").write_text(example)
    done = subprocess.run(
        [sys.executable, str(tmp_path / "asks.py"), service.endpoint], capture_output=True, text=True, check=True
    )
    assert done.stdout.startswith("1: found a motion")
    assert "'panda_joint1': 0.8" in done.stdout
