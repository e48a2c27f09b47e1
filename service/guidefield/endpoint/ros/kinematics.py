"""`compute_ik` and `compute_fk`: a moveit_msgs/GetPositionIK or GetPositionFK as kinematics requests of ours."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from guidefield.endpoint.ros.cdr import Types
from guidefield.endpoint.ros.poses import number, placement, pose_message, wire_of
from guidefield.endpoint.ros.refusals import MoveItCode, Refused
from guidefield.endpoint.ros.robot_messages import NANO, error_code, header, robot_state
from guidefield.endpoint.ros.scene_updates import with_state
from guidefield.endpoint.ros.snapshot import Snapshot
from guidefield.geometry.placements import se3
from guidefield.messages.kinematics_replies import ForwardKinematicsReply
from guidefield.messages.requests import ForwardKinematics, InverseKinematics, TargetPose
from guidefield.messages.values import LONGEST_TIME

IK_RESPONSE = "moveit_msgs/srv/GetPositionIK_Response"
FK_RESPONSE = "moveit_msgs/srv/GetPositionFK_Response"
UNSET_TIME = 1.0
"""How long is looked for a solution where a request doesn't say it [s]."""


@dataclass(frozen=True)
class AskedSolution:
    """What is asked of `compute_ik`: a request of ours, robot and scene."""

    request: InverseKinematics
    start: Snapshot


def asked_solution(message: Any, now: Snapshot) -> AskedSolution:
    """What a GetPositionIK asks for.

    Raises:
        Refused: if it isn't served; names the field.
    """
    asked = message.ik_request
    group = now.robot.group(asked.group_name)
    start = with_state(now, asked.robot_state, "ik_request.robot_state")
    _require_no_constraints(asked.constraints, "ik_request.constraints")
    link, stamped, where = _target(asked)
    start.robot.require_link(link, f"ik_request.{'ik_link_names' if asked.ik_link_names else 'ik_link_name'}")
    frame, moving = start.frame(stamped.header.frame_id, f"ik_request.{where}.header.frame_id")
    if moving is not None and start.robot.moves(moving, group):
        raise Refused(
            MoveItCode.FRAME_TRANSFORM_FAILURE,
            f"`ik_request.{where}.header.frame_id` {stamped.header.frame_id[:64]!r} moves with the group",
        )
    position, quaternion = wire_of(frame * placement(stamped.pose, f"ik_request.{where}.pose"))
    request = InverseKinematics(
        robot=start.robot.name,
        poses=[TargetPose(position, quaternion)],
        tip=link,
        group=group,
        scene=start.scene() if asked.avoid_collisions else None,
        collision_free=asked.avoid_collisions,
        attached_objects=start.attached() if asked.avoid_collisions else [],
        allowed_collisions=start.allowed() if asked.avoid_collisions else [],
        start_configurations=[dict(start.whole)],
        solutions=1,
        allowed_time=_allowed(asked.timeout),
    )
    return AskedSolution(request, start)


def solution_response(types: Types, asked: AskedSolution, solution: Mapping[str, float]) -> Any:
    """The response with a configuration of the group's joints."""
    message = f"a solution for {asked.request.tip}"
    return types.new(
        IK_RESPONSE,
        solution=robot_state(types, asked.start, solution),
        error_code=error_code(types, MoveItCode.SUCCESS, message),
    )


def refused_solution(types: Types, code: MoveItCode, message: str) -> Any:
    """The response where there is none."""
    return types.new(IK_RESPONSE, error_code=error_code(types, code, message))


@dataclass(frozen=True)
class AskedPlaces:
    """What is asked of `compute_fk`: a request of ours, and the frame in which poses are told, pinocchio.SE3."""

    request: ForwardKinematics
    links: tuple[str, ...]
    frame: str
    there: Any


def asked_places(message: Any, now: Snapshot) -> AskedPlaces:
    """What a GetPositionFK asks for.

    Raises:
        Refused: if it isn't served; names the field.
    """
    if not message.fk_link_names:
        raise Refused(MoveItCode.INVALID_LINK_NAME, "`fk_link_names` is empty")
    start = with_state(now, message.robot_state, "robot_state")
    links = tuple(start.robot.require_link(name, "fk_link_names") for name in message.fk_link_names)
    there, _ = start.frame(message.header.frame_id, "header.frame_id")
    request = ForwardKinematics(robot=start.robot.name, frames=list(links), configurations=[dict(start.whole)])
    return AskedPlaces(request, links, message.header.frame_id or start.robot.root, there)


def places_response(types: Types, asked: AskedPlaces, reply: ForwardKinematicsReply) -> Any:
    """The response with a pose for each link."""
    (found,) = reply.placements
    inside = [asked.there.inverse() * se3(one.position, one.quaternion_xyzw) for one in found]
    return types.new(
        FK_RESPONSE,
        pose_stamped=[
            types.new(
                "geometry_msgs/msg/PoseStamped",
                header=header(types, asked.frame),
                pose=pose_message(types, *wire_of(one)),
            )
            for one in inside
        ],
        fk_link_names=list(asked.links),
        error_code=error_code(types, MoveItCode.SUCCESS, ""),
    )


def refused_places(types: Types, code: MoveItCode, message: str) -> Any:
    """The response where there are none."""
    return types.new(FK_RESPONSE, error_code=error_code(types, code, message))


def _target(asked: Any) -> tuple[str, Any, str]:
    """The link, its stamped pose, and the field in which that stands."""
    if asked.pose_stamped_vector or asked.ik_link_names:
        if len(asked.pose_stamped_vector) != 1 or len(asked.ik_link_names) != 1:
            raise Refused(
                MoveItCode.INVALID_LINK_NAME,
                "`ik_request.pose_stamped_vector` and `ik_link_names`: one of each is served, got"
                f" {len(asked.pose_stamped_vector)} and {len(asked.ik_link_names)}",
            )
        return asked.ik_link_names[0], asked.pose_stamped_vector[0], "pose_stamped_vector[0]"
    if not asked.ik_link_name:
        raise Refused(MoveItCode.INVALID_LINK_NAME, "`ik_request.ik_link_name` is empty: name the link")
    return asked.ik_link_name, asked.pose_stamped, "pose_stamped"


def _require_no_constraints(constraints: Any, where: str) -> None:
    for field in ("joint_constraints", "position_constraints", "orientation_constraints", "visibility_constraints"):
        if getattr(constraints, field):
            raise Refused(MoveItCode.INVALID_GOAL_CONSTRAINTS, f"`{where}.{field}` isn't served")


def _allowed(timeout: Any) -> float:
    seconds = timeout.sec + timeout.nanosec / NANO
    if seconds <= 0.0:
        return UNSET_TIME
    return number(min(seconds, LONGEST_TIME), "ik_request.timeout")
