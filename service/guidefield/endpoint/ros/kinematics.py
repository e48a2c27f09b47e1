"""`compute_ik` and `compute_fk`: a moveit_msgs/GetPositionIK or GetPositionFK as kinematics requests of ours."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from guidefield.endpoint.ros.poses import number, placement, pose_message, wire_of
from guidefield.endpoint.ros.refusals import FrameRefused, LinkRefused, MoveItCode, require_no_constraints
from guidefield.endpoint.ros.robot_messages import NANO, error_code, header, robot_state
from guidefield.endpoint.ros.scene_updates import with_state
from guidefield.endpoint.ros.snapshot import Snapshot
from guidefield.geometry.placements import se3
from guidefield.messages.kinematics_replies import ForwardKinematicsReply
from guidefield.messages.requests import ForwardKinematics, InverseKinematics, TargetPose
from guidefield.messages.values import LONGEST_TIME

UNSET_TIME = 1.0
"""How long is looked for a solution where a request doesn't say it [s]."""


def asked_solution(message: Any, now: Snapshot) -> tuple[InverseKinematics, Snapshot]:
    """Return what a GetPositionIK asks for: a request of ours, and robot and scene.

    Raises Refused if it isn't served; names the field.
    """
    asked = message.ik_request
    group = now.robot.group(asked.group_name)
    start = with_state(now, asked.robot_state, "ik_request.robot_state")
    require_no_constraints(asked.constraints, "ik_request.constraints")
    link, stamped, where = _target(asked)
    start.robot.require_link(link, f"ik_request.{'ik_link_names' if asked.ik_link_names else 'ik_link_name'}")
    frame, moving = start.frame(stamped.header.frame_id, f"ik_request.{where}.header.frame_id")
    if moving is not None and start.robot.moves(moving, group):
        raise FrameRefused(
            f"`ik_request.{where}.header.frame_id` {stamped.header.frame_id[:64]!r} moves with the group"
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
    return request, start


def solution_response(link: str, start: Snapshot, solution: Mapping[str, float]) -> dict[str, Any]:
    """Return the response with a configuration of the group's joints for a link."""
    return {
        "solution": robot_state(start, solution),
        "error_code": error_code(MoveItCode.SUCCESS, f"a solution for {link}"),
    }


def asked_places(message: Any, now: Snapshot) -> tuple[ForwardKinematics, str, Any]:
    """Return what a GetPositionFK asks for: a request of ours, the frame of the poses, and its place, pinocchio.SE3.

    Raises Refused if it isn't served; names the field.
    """
    if not message.fk_link_names:
        raise LinkRefused("`fk_link_names` is empty")
    start = with_state(now, message.robot_state, "robot_state")
    links = [start.robot.require_link(name, "fk_link_names") for name in message.fk_link_names]
    there, _ = start.frame(message.header.frame_id, "header.frame_id")
    request = ForwardKinematics(robot=start.robot.name, frames=links, configurations=[dict(start.whole)])
    return request, message.header.frame_id or start.robot.root, there


def places_response(links: list[str], frame: str, there: Any, reply: ForwardKinematicsReply) -> dict[str, Any]:
    """Return the response with a pose for each link, in a frame that is at a place, pinocchio.SE3."""
    (found,) = reply.placements
    inside = [there.inverse() * se3(one.position, one.quaternion_xyzw) for one in found]
    return {
        "pose_stamped": [{"header": header(frame), "pose": pose_message(one)} for one in inside],
        "fk_link_names": links,
        "error_code": error_code(MoveItCode.SUCCESS, ""),
    }


def _target(asked: Any) -> tuple[str, Any, str]:
    """The link, its stamped pose, and the field in which that stands."""
    if asked.pose_stamped_vector or asked.ik_link_names:
        if len(asked.pose_stamped_vector) != 1 or len(asked.ik_link_names) != 1:
            raise LinkRefused(
                "`ik_request.pose_stamped_vector` and `ik_link_names`: one of each is served, got"
                f" {len(asked.pose_stamped_vector)} and {len(asked.ik_link_names)}"
            )
        return asked.ik_link_names[0], asked.pose_stamped_vector[0], "pose_stamped_vector[0]"
    if not asked.ik_link_name:
        raise LinkRefused("`ik_request.ik_link_name` is empty: name the link")
    return asked.ik_link_name, asked.pose_stamped, "pose_stamped"


def _allowed(timeout: Any) -> float:
    seconds = timeout.sec + timeout.nanosec / NANO
    if seconds <= 0.0:
        return UNSET_TIME
    return number(min(seconds, LONGEST_TIME), "ik_request.timeout")
