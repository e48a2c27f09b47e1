"""The services that are offered: what each is called, what it answers, and how it says no."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import msgspec

from guidefield.endpoint.ros import kinematics, motion_plan, planning_scene, state_validity
from guidefield.endpoint.ros.cdr import Types
from guidefield.endpoint.ros.engine_door import EngineDoor
from guidefield.endpoint.ros.known_scene import KnownScene
from guidefield.endpoint.ros.refusals import MoveItCode, Refused
from guidefield.endpoint.ros.scene_updates import updated
from guidefield.messages.kinematics_replies import ClearanceReply, ForwardKinematicsReply, InverseKinematicsReply
from guidefield.messages.plan_reply import PlanReply

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
                state_validity.refused_validity,
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
                lambda types, _code, _message: types.new(planning_scene.GET_RESPONSE),
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
        state = state_validity.asked_state(message, self._known.now)
        reply = self._engine("kinematics", state_validity.judgement(state), ClearanceReply, received)
        return Answered(state_validity.validity_response(self._types, state, reply))

    def _apply(self, message: Any, _received: float) -> Answered:
        self._known.update(lambda now: updated(now, message.scene))
        return Answered(planning_scene.applied(self._types, success=True))

    def _scene(self, message: Any, _received: float) -> Answered:
        return Answered(planning_scene.scene_response(self._types, self._known.now, message.components.components))

    def _refused_scene(self, types: Types, _code: MoveItCode, _message: str) -> Any:
        return planning_scene.applied(types, success=False)


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
