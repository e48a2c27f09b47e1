"""`check_state_validity`: a moveit_msgs/GetStateValidity as a question for what touches what."""

from __future__ import annotations

from typing import Any

from guidefield.endpoint.ros.cdr import Types
from guidefield.endpoint.ros.collision_objects import object_of
from guidefield.endpoint.ros.refusals import MoveItCode, Refused
from guidefield.endpoint.ros.robot_messages import header
from guidefield.endpoint.ros.scene_updates import with_state
from guidefield.endpoint.ros.snapshot import Snapshot
from guidefield.messages.kinematics_replies import ClearanceReply
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
    for field in ("joint_constraints", "position_constraints", "orientation_constraints", "visibility_constraints"):
        if getattr(message.constraints, field):
            raise Refused(MoveItCode.INVALID_GOAL_CONSTRAINTS, f"`constraints.{field}` isn't served")
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
