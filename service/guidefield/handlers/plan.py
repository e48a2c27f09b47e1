"""The plan request: its problem, the plan, and the reply, in order."""

from __future__ import annotations

import contextlib
import dataclasses
import time
from collections.abc import Callable
from typing import Any, Protocol

from guidefield.collision.preparation import StoppedError, Told, is_prepared, prepare
from guidefield.errors import GuidefieldError, Status
from guidefield.geometry.placements import se3
from guidefield.handlers.plan_problem import problem_of
from guidefield.handlers.plan_reply import reply_to
from guidefield.handlers.planes import Derivation, with_derived_planes
from guidefield.messages import requests
from guidefield.messages.replies import PlanReply
from guidefield.messages.requests import PlanRequest
from guidefield.planner.guide.attempts import ATTEMPTS
from guidefield.planner.plan import Plan, Planner, plan, refused
from guidefield.planner.quality import ClearanceProfile, clearance, clearance_profile
from guidefield.planner.task.conditions import Budget
from guidefield.planner.task.problem import ConfigurationGoal, Problem
from guidefield.planner.task.trace import Event, Silent
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.reduced_model import select
from guidefield.robot.model.configuration import LimitFault, limit_faults
from guidefield.robot.model.model import JointKind, RobotModel
from guidefield.scene.guide_plane import GuidePlane
from guidefield.scene.scene import Scene


class Recording(Protocol):
    """Somebody who records a run: an observer who is told the end, once."""

    def observe(self, event: Event) -> None:
        """Be told of an event."""

    def finish(self, reply: PlanReply, profile: Callable[[], ClearanceProfile | None]) -> None:
        """Be told the end, and write; the clearance along the way is measured when it is asked for."""


Record = Callable[[PlanningGroup, Scene, tuple[GuidePlane, ...]], Recording | None]
"""Opens the recording of a run, once it is known what moves where."""


def answer_plan(
    request: PlanRequest,
    robot: RobotModel,
    scene: Scene,
    *,
    run_id: str,
    received: float,
    began: float | None = None,
    record: Record = lambda *_: None,
    preparing: Told = lambda _: None,
    cancelled: Callable[[], bool] = lambda: False,
) -> PlanReply:
    """Plan, and say what came of it.

    Args:
        request: What is asked.
        robot: The robot that it names.
        scene: The scene that it names.
        run_id: Name of the run.
        received: When it arrived, on the clock of `time.monotonic` [s]; the deadline counts from then.
        began: When loading its robot and scene began, on the same clock [s]; None: now.
        record: Opens the recording.
        preparing: Told what of the robot is prepared, where that isn't known from before.
        cancelled: Whether somebody asked to stop.

    Raises:
        GuidefieldError: InvalidGroup, InvalidGoal, InvalidConfiguration, UnknownFrame, UnknownObject, SceneInvalid or
            MalformedRequest where the question is ill-posed, or asks for what this version doesn't serve.
    """
    began = time.monotonic() if began is None else began
    budget = Budget(received + request.allowed_planning_time, cancelled)
    problem, warnings = problem_of(request, robot, scene, budget)
    attempts = ATTEMPTS[request.minimizer](problem.group)
    refusal = _refusal(problem) or _unprepared(request, problem, preparing)
    load_seconds = time.monotonic() - began - (sum(refusal.seconds.values()) if refusal else 0.0)
    derivation = Derivation()
    if refusal is None:
        problem, derivation = with_derived_planes(problem, request)
    begin = time.monotonic()
    recording = record(problem.group, scene, problem.guide_planes)
    load_seconds += time.monotonic() - begin
    problem = dataclasses.replace(problem, observer=recording or Silent())
    made = derivation.told_in(refusal or plan(problem, Planner(request.planner), attempts))
    measured, begin = None, time.monotonic()
    if made.trajectory is not None:
        measured = clearance(made.trajectory, problem)
    measure_seconds = time.monotonic() - begin
    reply = reply_to(request, problem, made, measured, run_id, received, load_seconds, measure_seconds, warnings)
    if recording is not None:
        recording.finish(reply, lambda: None if measured is None else clearance_profile(measured, problem))
    return reply


def _refusal(problem: Problem) -> Plan | None:
    """The plan of a problem whose start or goal is beyond a joint limit; None where they are not."""
    faults = limit_faults(problem.group.robot.joints, problem.group.q_reference)
    if faults:
        return refused(problem, Status.START_STATE_INVALID, *_limit_message("start", faults, problem.group.robot))
    if isinstance(problem.goal, ConfigurationGoal):
        configurations = problem.goal.configurations
        faults = limit_faults(problem.group.joints, configurations[0])
        if faults:
            message, details = _limit_message("goal", faults, problem.group.robot)
            if len(configurations) > 1:
                message = (
                    f"all {len(configurations)} goals are outside of limits; {message.replace('goal', 'first', 1)}"
                )
            return refused(problem, Status.GOAL_STATE_INVALID, message, details)
    return None


def prepare_ahead(request: PlanRequest, load: Callable[[requests.RobotReference], RobotModel]) -> None:
    """Prepare a request's robot before its time begins. What can't be used is refused later, where that is kept."""
    with contextlib.suppress(GuidefieldError):
        robot = load(request.robot)
        if is_prepared(robot) or not _connects(request):
            return
        base = request.robot_placement
        select(robot, request.group, request.tip, robot.rest, se3(base.position, base.quaternion_xyzw))
        prepare(robot)


def _connects(request: PlanRequest) -> bool:
    """Whether a plan certainly needs a connection by lanes."""
    return not isinstance(request.goal, requests.GuidePlaneGoal)


def _unprepared(request: PlanRequest, problem: Problem, preparing: Told) -> Plan | None:
    """Prepare the robot if a connection needs it; the plan if time was up before that, None if it wasn't."""
    if not _connects(request):
        return None
    try:
        prepare(problem.group.robot, problem.budget.spent, preparing)
    except StoppedError as stopped:
        message = (
            f"the first use of a robot prepares its meshes, and time was up before {stopped}; what is prepared is kept:"
            " ask again, or allow more time for the first plan"
        )
        details = {"stage": "load", "preparing": str(stopped)}
        return refused(problem, problem.budget.spent() or Status.TIMED_OUT, message, details)
    return None


def _limit_message(end: str, faults: list[LimitFault], robot: RobotModel) -> tuple[str, dict[str, Any]]:
    """The joint that is farthest beyond a limit, as a sentence and values, and all others as values."""
    first, *others = sorted(faults, key=lambda fault: -fault.excess)
    joint = robot.joint(first.joint)
    unit = {1: " m" if joint.kind is JointKind.PRISMATIC else " rad"}.get(joint.nv, "") if joint else ""
    more = f" (and {', '.join(fault.joint for fault in others)})" if others else ""
    return (
        f"the {end} has joint {first.joint} at {first.value:.6g}, {first.excess:.3g}{unit} outside its limits"
        f" [{first.lower:.6g}, {first.upper:.6g}]{more}",
        {
            "stage": end,
            "joint": first.joint,
            "value": first.value,
            "limits": [first.lower, first.upper],
            "excess": first.excess,
            "joints": [first.joint, *(fault.joint for fault in others)],
        },
    )
