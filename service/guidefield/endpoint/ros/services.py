"""MoveIt's services: each reads its request, asks the engine through the common queue, and makes its response.

Messages to be sent are dicts of their fields here; what isn't given is zero, empty or false. A new service is a line in
`Services.all` with its definition in `moveit.msg`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any, TypeVar

import msgspec

from guidefield.endpoint.link import ROS_USER
from guidefield.endpoint.ros import motion_plan
from guidefield.endpoint.ros.collision_objects import message_of, object_of
from guidefield.endpoint.ros.refusals import (
    FrameRefused,
    LinkRefused,
    Refused,
    moveit_code,
    number,
    placement,
    pose_message,
    require_no_constraints,
)
from guidefield.endpoint.ros.robot_messages import NANO, error_code, header, robot_state
from guidefield.endpoint.ros.snapshot import KnownScene, Snapshot, apply_scene, with_state
from guidefield.errors import Status
from guidefield.geometry.surfaces import se3, wire_pose
from guidefield.messages import codec, keys
from guidefield.messages.codec import Encoding
from guidefield.messages.kinematics import ClearanceReply, ForwardKinematicsReply, InverseKinematicsReply
from guidefield.messages.plan_reply import PlanReply
from guidefield.messages.replies import ErrorReply
from guidefield.messages.requests import Clearance, ForwardKinematics, InverseKinematics, TargetPose
from guidefield.messages.values import LONGEST_TIME, Reply
from guidefield.pool.waiting import Answer

UNSET_TIME = 1.0  # time for inverse kinematics if a request has none [s]


def read_ik_request(message: Any, now: Snapshot) -> tuple[InverseKinematics, Snapshot]:
    """Read a GetPositionIK: a request of ours, and robot and scene; raises Refused, with the field, if not served."""
    ik_request = message.ik_request
    group = now.robot.group(ik_request.group_name)
    start = with_state(now, ik_request.robot_state, "ik_request.robot_state")
    require_no_constraints(ik_request.constraints, "ik_request.constraints")
    link, stamped, where = _target(ik_request)
    start.robot.require_link(link, f"ik_request.{'ik_link_names' if ik_request.ik_link_names else 'ik_link_name'}")
    frame, moving = start.frame(stamped.header.frame_id, f"ik_request.{where}.header.frame_id")
    if moving is not None and start.robot.moves(moving, group):
        raise FrameRefused(
            f"`ik_request.{where}.header.frame_id` {stamped.header.frame_id[:64]!r} moves with the group"
        )
    position, quaternion = wire_pose(frame * placement(stamped.pose, f"ik_request.{where}.pose"))
    request = InverseKinematics(
        robot=start.robot.name,
        poses=[TargetPose(position, quaternion)],
        tip=link,
        group=group,
        scene=start.scene() if ik_request.avoid_collisions else None,
        collision_free=ik_request.avoid_collisions,
        attached_objects=start.attached() if ik_request.avoid_collisions else [],
        allowed_collisions=start.allowed() if ik_request.avoid_collisions else [],
        start_configurations=[dict(start.whole)],
        solutions=1,
        allowed_time=_read_timeout(ik_request.timeout),
    )
    return request, start


def solution_response(link: str, start: Snapshot, solution: Mapping[str, float]) -> dict[str, Any]:
    """Return the response with a configuration of the group's joints for a link."""
    return {
        "solution": robot_state(start, solution),
        "error_code": error_code(Status.SUCCESS, f"a solution for {link}"),
    }


def read_fk_request(message: Any, now: Snapshot) -> tuple[ForwardKinematics, str, Any]:
    """Read a GetPositionFK: a request of ours, the frame of the poses, and that frame's place, pinocchio.SE3.

    Raises Refused, with the name of the field, if it isn't served.
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
        "error_code": error_code(Status.SUCCESS, ""),
    }


def _target(ik_request: Any) -> tuple[str, Any, str]:
    if ik_request.pose_stamped_vector or ik_request.ik_link_names:
        if len(ik_request.pose_stamped_vector) != 1 or len(ik_request.ik_link_names) != 1:
            raise LinkRefused(
                "`ik_request.pose_stamped_vector` and `ik_link_names`: one of each is served, got"
                f" {len(ik_request.pose_stamped_vector)} and {len(ik_request.ik_link_names)}"
            )
        return ik_request.ik_link_names[0], ik_request.pose_stamped_vector[0], "pose_stamped_vector[0]"
    if not ik_request.ik_link_name:
        raise LinkRefused("`ik_request.ik_link_name` is empty: name the link")
    return ik_request.ik_link_name, ik_request.pose_stamped, "pose_stamped"


def _read_timeout(timeout: Any) -> float:
    seconds = timeout.sec + timeout.nanosec / NANO
    if seconds <= 0.0:
        return UNSET_TIME
    return number(min(seconds, LONGEST_TIME), "ik_request.timeout")


ROBOT_LINK, WORLD_OBJECT, ROBOT_ATTACHED = range(3)  # kinds of bodies in a moveit_msgs/ContactInformation
(SETTINGS, STATE, ATTACHED, OBJECT_NAMES, GEOMETRY, OCTOMAP, TRANSFORMS, MATRIX, PADDING, COLORS) = (
    1 << bit for bit in range(10)
)
"""Components of a planning scene that can be requested, bits of moveit_msgs/PlanningSceneComponents; none means all."""
Ask = Callable[[keys.Query, float], Future[Answer]]
"""Has a query answered that arrived at a time, by `time.monotonic()` [s]: `Endpoint.ask`."""

_R = TypeVar("_R", bound=Reply)


def scene_response(now: Snapshot, components: int) -> dict[str, Any]:
    """Return the response of `get_planning_scene` with the requested components."""
    wanted = components or ~0
    scene: dict[str, Any] = {}
    if wanted & SETTINGS:
        scene |= {"name": now.name, "robot_model_name": now.robot.name}
    if wanted & (STATE | ATTACHED):
        scene["robot_state"] = robot_state(now, held=bool(wanted & ATTACHED))
    if wanted & (OBJECT_NAMES | GEOMETRY):
        shaped = bool(wanted & GEOMETRY)
        objects = [message_of(name, thing, now.robot.root, geometry=shaped) for name, thing in now.objects.items()]
        scene["world"] = {"collision_objects": objects}
    if wanted & MATRIX:
        left_out = {frozenset(pair.links) for pair in now.robot.model.pairs_left_out}
        names = {*now.robot.links, *now.objects, *now.held, *(name for pair in now.matrix.pairs for name in pair)}
        scene["allowed_collision_matrix"] = now.matrix.message(names, left_out)
    if wanted & PADDING:
        scene["link_padding"] = [{"link_name": link} for link in now.robot.links]
        scene["link_scale"] = [{"link_name": link, "scale": 1.0} for link in now.robot.links]
    if wanted & COLORS:
        scene["object_colors"] = [{"id": name, "color": color} for name, color in now.colors.items()]
    return {"scene": scene}


@dataclass(frozen=True)
class ServiceAnswer:
    """A response, and messages by topic that are published after it."""

    response: dict[str, Any]
    published: Mapping[str, dict[str, Any]] = field(default_factory=dict)


@dataclass(frozen=True)
class Service:
    """One service."""

    name: str  # without the first slash
    type_name: str  # its type
    # makes the response to a request that came at a time, by `time.monotonic()` [s]; raises Refused
    answer: Callable[[Any, float], ServiceAnswer]
    # makes the response with an error code; None: it has no place for one, and the reason is logged
    with_error: Callable[[dict[str, Any]], dict[str, Any]] | None = None

    def refuse(self, code: int, sentence: str) -> ServiceAnswer:
        """Return the response of a request that isn't served."""
        return ServiceAnswer({} if self.with_error is None else self.with_error(error_code(code, sentence)))


class Services:
    """Answers requests of MoveIt's services with the engine."""

    def __init__(self, known: KnownScene, ask: Ask) -> None:
        self._known, self._ask = known, ask

    def all(self) -> list[Service]:
        """Return every service."""
        srv = "moveit_msgs/srv/"

        def with_error(code: dict[str, Any]) -> dict[str, Any]:
            return {"error_code": code}

        def plan_with_error(code: dict[str, Any]) -> dict[str, Any]:
            return {"motion_plan_response": {"error_code": code}}

        return [
            Service("plan_kinematic_path", f"{srv}GetMotionPlan", self._plan, plan_with_error),
            Service("compute_ik", f"{srv}GetPositionIK", self._solution, with_error),
            Service("compute_fk", f"{srv}GetPositionFK", self._places, with_error),
            Service("check_state_validity", f"{srv}GetStateValidity", self._validity),
            Service("apply_planning_scene", f"{srv}ApplyPlanningScene", self._apply),
            Service("get_planning_scene", f"{srv}GetPlanningScene", self._scene),
        ]

    def _engine(self, key: str, request: msgspec.Struct, kind: type[_R], received: float) -> _R:
        payload = codec.encode(request, Encoding.MSGPACK)
        is_reply, answer = self._ask(
            keys.Query((key,), {}, payload, Encoding.MSGPACK, user=ROS_USER), received
        ).result()
        if not is_reply:
            error = msgspec.msgpack.decode(answer, type=ErrorReply)
            raise Refused(f"{error.name}: {error.message}", moveit_code(error.code))
        return msgspec.msgpack.decode(answer, type=kind)

    def _plan(self, message: Any, received: float) -> ServiceAnswer:
        plan = motion_plan.read_plan_request(message, self._known.now)
        if plan.choices:
            queries = motion_plan.request_solutions(plan)
            found = [self._engine("kinematics", one, InverseKinematicsReply, received) for one in queries]
            plan = motion_plan.with_solutions(plan, found)
        reply = self._engine("plan", plan.request, PlanReply, received)
        response = motion_plan.plan_response(plan, reply, time.monotonic() - received)
        published = {"guidefield/plans": {"data": _figures(reply)}}
        if "trajectory" in response["motion_plan_response"]:
            published["display_planned_path"] = motion_plan.display(plan, response)
        return ServiceAnswer(response, published)

    def _solution(self, message: Any, received: float) -> ServiceAnswer:
        request, start = read_ik_request(message, self._known.now)
        reply = self._engine("kinematics", request, InverseKinematicsReply, received)
        (found,), (reason,) = reply.configurations, reply.reasons
        if not found:
            raise Refused(reason, Status.NO_IK_SOLUTION)
        solution = {joint: value for joint, value in found[0].items() if not isinstance(value, list)}
        return ServiceAnswer(solution_response(str(request.tip), start, solution))

    def _places(self, message: Any, received: float) -> ServiceAnswer:
        request, frame, there = read_fk_request(message, self._known.now)
        reply = self._engine("kinematics", request, ForwardKinematicsReply, received)
        return ServiceAnswer(places_response(request.frames, frame, there, reply))

    def _validity(self, message: Any, received: float) -> ServiceAnswer:
        now = self._known.now
        if message.group_name:
            now.robot.group(message.group_name)
        require_no_constraints(message.constraints, "constraints")
        state = with_state(now, message.robot_state, "robot_state")
        request = Clearance(
            robot=state.robot.name,
            scene=state.scene(),
            configurations=[dict(state.whole)],
            attached_objects=state.attached(),
            allowed_collisions=state.allowed(),
            contacts=True,
        )
        reply = self._engine("kinematics", request, ClearanceReply, received)
        assert reply.contacts is not None, "the request wants them"
        (pairs,) = reply.contacts
        return ServiceAnswer({"valid": not pairs, "contacts": [_contact(state, pair) for pair in pairs]})

    def _apply(self, message: Any, _received: float) -> ServiceAnswer:
        self._known.update(lambda now: apply_scene(now, message.scene))
        return ServiceAnswer({"success": True})

    def _scene(self, message: Any, _received: float) -> ServiceAnswer:
        return ServiceAnswer(scene_response(self._known.now, message.components.components))


def _contact(state: Snapshot, pair: list[str]) -> dict[str, Any]:
    (first, kind), (second, other) = (_body(state, name) for name in pair)
    bodies = {"contact_body_1": first, "body_type_1": kind, "contact_body_2": second, "body_type_2": other}
    return {"header": header(state.robot.root), **bodies}


def _body(state: Snapshot, name: str) -> tuple[str, int]:
    if name in state.robot.links:
        return name, ROBOT_LINK
    held = object_of(name, state.held)
    if held is not None:
        return held, ROBOT_ATTACHED
    return object_of(name, state.objects) or name, WORLD_OBJECT


def _figures(reply: PlanReply) -> str:
    names = ("run_id", "status", "certificate", "clearance", "self_clearance", "timing", "recording")
    return msgspec.json.encode({name: getattr(reply, name) for name in names}).decode()
