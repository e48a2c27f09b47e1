"""The services that are offered: what each is called, what it answers, and how it says no."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import msgspec

from guidefield.endpoint.ros import kinematics, motion_plan
from guidefield.endpoint.ros.cdr import Types
from guidefield.endpoint.ros.collision_objects import message_of, object_of
from guidefield.endpoint.ros.engine_door import EngineDoor
from guidefield.endpoint.ros.refusals import MoveItCode, Refused
from guidefield.endpoint.ros.robot_messages import header, robot_state
from guidefield.endpoint.ros.scene_updates import updated, with_state
from guidefield.endpoint.ros.snapshot import KnownScene, Snapshot
from guidefield.messages.kinematics_replies import ClearanceReply, ForwardKinematicsReply, InverseKinematicsReply
from guidefield.messages.plan_reply import PlanReply
from guidefield.messages.requests import Clearance

RESPONSE = "moveit_msgs/srv/GetStateValidity_Response"
ROBOT_LINK, WORLD_OBJECT, ROBOT_ATTACHED = range(3)
"""Kinds of bodies in a contact."""


def asked_state(message: Any, now: Snapshot) -> Snapshot:
    """Robot and scene of a GetStateValidity.

    Raises:
        Refused: if it isn't served; names the field.
    """
    if message.group_name:
        now.robot.group(message.group_name)
    for name in ("joint_constraints", "position_constraints", "orientation_constraints", "visibility_constraints"):
        if getattr(message.constraints, name):
            raise Refused(MoveItCode.INVALID_GOAL_CONSTRAINTS, f"`constraints.{name}` isn't served")
    return with_state(now, message.robot_state, "robot_state")


def judgement(state: Snapshot) -> Clearance:
    """The request that tells what touches what, with what is held and what may touch."""
    return Clearance(
        robot=state.robot.name,
        scene=state.scene(),
        configurations=[dict(state.whole)],
        attached_objects=state.attached(),
        allowed_collisions=state.allowed(),
        contacts=True,
    )


def validity_response(types: Types, state: Snapshot, reply: ClearanceReply) -> Any:
    """Whether nothing touches; else a contact for each pair that does. Joint limits don't count, as in MoveIt."""
    assert reply.contacts is not None, "they were asked for"
    (pairs,) = reply.contacts
    return types.new(RESPONSE, valid=not pairs, contacts=[_contact(types, state, pair) for pair in pairs])


def refused_validity(types: Types, _code: MoveItCode, _message: str) -> Any:
    """The response of a request that isn't served: it has no place for a reason, which is logged instead."""
    return types.new(RESPONSE, valid=False)


def _contact(types: Types, state: Snapshot, pair: list[str]) -> Any:
    """A contact of two bodies; where and how deep isn't told."""
    (first, kind), (second, other) = (_body(state, name) for name in pair)
    return types.new(
        "moveit_msgs/msg/ContactInformation",
        header=header(types, state.robot.root),
        contact_body_1=first,
        body_type_1=kind,
        contact_body_2=second,
        body_type_2=other,
    )


def _body(state: Snapshot, name: str) -> tuple[str, int]:
    if name in state.robot.links:
        return name, ROBOT_LINK
    held = object_of(name, state.held)
    if held is not None:
        return held, ROBOT_ATTACHED
    return object_of(name, state.objects) or name, WORLD_OBJECT


GET_RESPONSE = "moveit_msgs/srv/GetPlanningScene_Response"
APPLY_RESPONSE = "moveit_msgs/srv/ApplyPlanningScene_Response"
(SETTINGS, STATE, ATTACHED, OBJECT_NAMES, GEOMETRY, OCTOMAP, TRANSFORMS, MATRIX, PADDING, COLORS) = (
    1 << bit for bit in range(10)
)
"""Components that can be asked for; none means all."""


def scene_response(types: Types, now: Snapshot, components: int) -> Any:
    """The response with the components that are asked for."""
    wanted = components or ~0
    scene = types.new("moveit_msgs/msg/PlanningScene")
    if wanted & SETTINGS:
        scene.name, scene.robot_model_name = now.name, now.robot.name
    if wanted & (STATE | ATTACHED):
        scene.robot_state = robot_state(types, now, held=bool(wanted & ATTACHED))
    if wanted & (OBJECT_NAMES | GEOMETRY):
        scene.world.collision_objects = [
            message_of(types, name, thing, now.robot.root, geometry=bool(wanted & GEOMETRY))
            for name, thing in now.objects.items()
        ]
    if wanted & MATRIX:
        left_out = {frozenset(pair.links) for pair in now.robot.model.pairs_left_out}
        names = {*now.robot.links, *now.objects, *now.held, *(name for pair in now.matrix.pairs for name in pair)}
        scene.allowed_collision_matrix = now.matrix.message(types, names, left_out)
    if wanted & PADDING:
        scene.link_padding = [types.new("moveit_msgs/msg/LinkPadding", link_name=link) for link in now.robot.links]
        scene.link_scale = [
            types.new("moveit_msgs/msg/LinkScale", link_name=link, scale=1.0) for link in now.robot.links
        ]
    if wanted & COLORS:
        scene.object_colors = [
            types.new("moveit_msgs/msg/ObjectColor", id=name, color=color) for name, color in now.colors.items()
        ]
    return types.new(GET_RESPONSE, scene=scene)


def applied(types: Types, *, success: bool) -> Any:
    """The response of `apply_planning_scene`; it has no place for a reason, which is logged instead."""
    return types.new(APPLY_RESPONSE, success=success)


_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Answered:
    """A response, and messages to be published by topic once it is on its way: who asked doesn't wait for them."""

    response: Any
    published: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Service:
    """One service.

    Attributes:
        name: Without the first slash.
        type_name: Its type.
        answer: The response to a request that came at a time, by `time.monotonic()` [s]; raises Refused.
        refuse: The response of a request that isn't served, with the reason where there is a place for it.
        has_place: Whether there is a place for the reason; else it is logged.
    """

    name: str
    type_name: str
    answer: Callable[[Any, float], Answered]
    refuse: Callable[[Types, MoveItCode, str], Any]
    has_place: bool = True


class Services:
    """Answers requests of MoveIt's services with the engine.

    Args:
        types: Of messages.
        known: What is known of robot and scene.
        engine: Where requests of ours are answered.
    """

    def __init__(self, types: Types, known: KnownScene, engine: EngineDoor) -> None:
        self._types = types
        self._known = known
        self._engine = engine

    def all(self) -> list[Service]:
        """Every service."""
        scene_refused = self._refused_scene
        return [
            Service("plan_kinematic_path", "moveit_msgs/srv/GetMotionPlan", self._plan, motion_plan.refused_plan),
            Service("compute_ik", "moveit_msgs/srv/GetPositionIK", self._solution, kinematics.refused_solution),
            Service("compute_fk", "moveit_msgs/srv/GetPositionFK", self._places, kinematics.refused_places),
            Service(
                "check_state_validity",
                "moveit_msgs/srv/GetStateValidity",
                self._validity,
                refused_validity,
                has_place=False,
            ),
            Service(
                "apply_planning_scene",
                "moveit_msgs/srv/ApplyPlanningScene",
                self._apply,
                scene_refused,
                has_place=False,
            ),
            Service(
                "get_planning_scene",
                "moveit_msgs/srv/GetPlanningScene",
                self._scene,
                lambda types, _code, _message: types.new(GET_RESPONSE),
                has_place=False,
            ),
        ]

    def _plan(self, message: Any, received: float) -> Answered:
        asked = motion_plan.asked_plan(message, self._known.now)
        if asked.choices:
            looked_for = motion_plan.asked_solutions(asked)
            found = [self._engine("kinematics", one, InverseKinematicsReply, received) for one in looked_for]
            asked = motion_plan.with_solutions(asked, found)
        reply = self._engine("plan", asked.request, PlanReply, received)
        response = motion_plan.plan_response(self._types, asked, reply, time.monotonic() - received)
        published = {"guidefield/plans": self._types.new("std_msgs/msg/String", data=_figures(reply))}
        if response.motion_plan_response.error_code.val == MoveItCode.SUCCESS:
            published["display_planned_path"] = motion_plan.display(self._types, asked, response)
        return Answered(response, published)

    def _solution(self, message: Any, received: float) -> Answered:
        asked = kinematics.asked_solution(message, self._known.now)
        reply = self._engine("kinematics", asked.request, InverseKinematicsReply, received)
        (found,), (reason,) = reply.configurations, reply.reasons
        if not found:
            raise Refused(MoveItCode.NO_IK_SOLUTION, reason)
        solution = {joint: value for joint, value in found[0].items() if not isinstance(value, list)}
        return Answered(kinematics.solution_response(self._types, asked, solution))

    def _places(self, message: Any, received: float) -> Answered:
        asked = kinematics.asked_places(message, self._known.now)
        reply = self._engine("kinematics", asked.request, ForwardKinematicsReply, received)
        return Answered(kinematics.places_response(self._types, asked, reply))

    def _validity(self, message: Any, received: float) -> Answered:
        state = asked_state(message, self._known.now)
        reply = self._engine("kinematics", judgement(state), ClearanceReply, received)
        return Answered(validity_response(self._types, state, reply))

    def _apply(self, message: Any, _received: float) -> Answered:
        self._known.update(lambda now: updated(now, message.scene))
        return Answered(applied(self._types, success=True))

    def _scene(self, message: Any, _received: float) -> Answered:
        return Answered(scene_response(self._types, self._known.now, message.components.components))

    def _refused_scene(self, types: Types, _code: MoveItCode, _message: str) -> Any:
        return applied(types, success=False)


def _figures(reply: PlanReply) -> str:
    """What a plan's message has no place for, as JSON: certificate, clearances, times, the run and its recording."""
    told = {
        "run_id": reply.run_id,
        "status": reply.status,
        "certificate": reply.certificate,
        "clearance": reply.clearance,
        "self_clearance": reply.self_clearance,
        "timing": reply.timing,
        "recording": reply.recording,
    }
    return msgspec.json.encode(told).decode()
