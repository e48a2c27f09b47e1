"""Payloads of MoveIt's services, whole and broken: what a node, or anybody else, might send."""

from __future__ import annotations

import math
import random
import struct
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from guidefield.endpoint.link import Distribution
from guidefield.endpoint.ros.rmw_zenoh import types_of

TYPES = types_of(Distribution.JAZZY)
SERVICES = {
    "plan_kinematic_path": "moveit_msgs/srv/GetMotionPlan",
    "compute_ik": "moveit_msgs/srv/GetPositionIK",
    "compute_fk": "moveit_msgs/srv/GetPositionFK",
    "check_state_validity": "moveit_msgs/srv/GetStateValidity",
    "apply_planning_scene": "moveit_msgs/srv/ApplyPlanningScene",
    "get_planning_scene": "moveit_msgs/srv/GetPlanningScene",
}
NUMBERS = (0.0, -0.0, 1.0, -1.0, 1e-9, 1e9, 1e308, -1e308, 5e-324, math.nan, math.inf, -math.inf, 0.3)
TEXTS = ("", "arm", "panda_hand", "panda_joint1", "world", "box", "box/0", "/", "é" * 300, "x" * 5000, "../etc")
WORDS = (0, 1, 2**31 - 1, 2**31, 2**32 - 1, 10**6, 16)


@dataclass(frozen=True)
class Sent:
    """A query to a service.

    Attributes:
        name: Of the service.
        payload: Its bytes.
        attachment: Bytes, or None.
    """

    name: str
    payload: bytes
    attachment: bytes | None


def draw_payload(rng: random.Random) -> Sent:
    """A request with some of its fields, or of its bytes, changed."""
    name = rng.choice(list(SERVICES))
    request, kind = _request(rng, name), f"{SERVICES[name]}_Request"
    for _ in range(rng.choice((0, 0, 1, 1, 2, 5))):
        _change(rng, request)
    data = bytearray(TYPES.write(request, kind))
    if rng.random() < 0.6:
        _break(rng, data)
    return Sent(name, bytes(data), _attachment(rng))


def _request(rng: random.Random, name: str) -> Any:
    new, kind = TYPES.new, f"{SERVICES[name]}_Request"
    joint = new("moveit_msgs/msg/JointConstraint", joint_name="panda_joint1", position=0.3, tolerance_above=0.1)
    ball = new("shape_msgs/msg/SolidPrimitive", type=2, dimensions=[0.1])
    box = new("moveit_msgs/msg/CollisionObject", id="box", primitives=[ball], primitive_poses=[_pose()])
    state = new(
        "moveit_msgs/msg/RobotState",
        joint_state=new("sensor_msgs/msg/JointState", name=["panda_joint1"], position=[0.1]),
        is_diff=True,
    )
    match name:
        case "plan_kinematic_path":
            region = new("moveit_msgs/msg/BoundingVolume", primitives=[ball], primitive_poses=[_pose()])
            place = new("moveit_msgs/msg/PositionConstraint", link_name="panda_hand", constraint_region=region)
            turn = new("moveit_msgs/msg/OrientationConstraint", link_name="panda_hand", absolute_x_axis_tolerance=0.1,
                       absolute_y_axis_tolerance=0.1, absolute_z_axis_tolerance=0.1)  # fmt: skip
            goals = [
                new("moveit_msgs/msg/Constraints", joint_constraints=[joint]),
                new("moveit_msgs/msg/Constraints", position_constraints=[place], orientation_constraints=[turn]),
            ]
            asked = new("moveit_msgs/msg/MotionPlanRequest", group_name="arm", start_state=state,
                        goal_constraints=[rng.choice(goals)], allowed_planning_time=0.02)  # fmt: skip
            return new(kind, motion_plan_request=asked)
        case "compute_ik":
            asked = new("moveit_msgs/msg/PositionIKRequest", group_name="arm", ik_link_name="panda_hand",
                        robot_state=state, timeout=new("builtin_interfaces/msg/Duration", nanosec=20_000_000),
                        pose_stamped=new("geometry_msgs/msg/PoseStamped", pose=_pose()))  # fmt: skip
            return new(kind, ik_request=asked)
        case "compute_fk":
            return new(kind, fk_link_names=["panda_hand"], robot_state=state)
        case "check_state_validity":
            return new(kind, robot_state=state, group_name="arm")
        case "apply_planning_scene":
            world = new("moveit_msgs/msg/PlanningSceneWorld", collision_objects=[box])
            return new(kind, scene=new("moveit_msgs/msg/PlanningScene", is_diff=True, world=world))
    return new(kind)


def _pose() -> Any:
    return TYPES.new("geometry_msgs/msg/Pose", position=TYPES.new("geometry_msgs/msg/Point", x=0.4, z=0.6))


def _change(rng: random.Random, message: Any) -> None:
    """Change one field somewhere in a message."""
    while True:
        field = rng.choice([one for one in fields(message) if one.init])
        value = getattr(message, field.name)
        if isinstance(value, list) and value and not isinstance(value[0], str) and rng.random() < 0.8:
            value = rng.choice(value)
        if hasattr(value, "__msgtype__") and rng.random() < 0.9:
            message = value
            continue
        break
    match value:
        case bool():
            setattr(message, field.name, not value)
        case str():
            setattr(message, field.name, rng.choice(TEXTS))
        case float():
            setattr(message, field.name, rng.choice(NUMBERS))
        case int():
            setattr(message, field.name, rng.choice((0, 1, 2, 3, 4, 100)))
        case list():
            value.extend(value[:1] * rng.choice((1, 2, 50)))
        case np.ndarray() if value.dtype.kind == "f":
            size = rng.choice((0, 1, 2, 3, 4, 200))
            setattr(message, field.name, np.array([rng.choice(NUMBERS) for _ in range(size)], value.dtype))


def _break(rng: random.Random, data: bytearray) -> None:
    """Change some bytes: cut, flipped, put in, or a length that is absurd."""
    for _ in range(rng.choice((1, 1, 2, 4))):
        at = rng.randrange(len(data) + 1)
        match rng.randrange(5):
            case 0:
                del data[at:]
            case 1:
                data[at : at + rng.randrange(4)] = rng.randbytes(rng.randrange(6))
            case 2 if len(data) > 8:
                at = 4 * rng.randrange(1, len(data) // 4)
                data[at : at + 4] = struct.pack("<I", rng.choice(WORDS))
            case 3:
                data[at:at] = bytes(rng.choice((1, 4, 1000)))
            case _ if data:
                data[at % len(data)] ^= 1 << rng.randrange(8)


def _attachment(rng: random.Random) -> bytes | None:
    match rng.randrange(6):
        case 0:
            return None
        case 1:
            return rng.randbytes(rng.randrange(60))
        case 2:
            return bytes(100_000)
    return struct.pack("<qqB", rng.randrange(2**60), 0, 16) + rng.randbytes(16)
