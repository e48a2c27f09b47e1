"""Plans that are refused before they begin: an end beyond a limit, or a robot that could not be prepared in time."""

from __future__ import annotations

from typing import Any

from guidefield.aside import StoppedError
from guidefield.collision.preparation import Told
from guidefield.errors import Status
from guidefield.handlers.preparing import lay_out_in_time, prepare_in_time
from guidefield.messages import requests
from guidefield.messages.requests import PlanRequest
from guidefield.planner.plan import Plan, refused, unprepared
from guidefield.planner.task.problem import ConfigurationGoal, Problem
from guidefield.robot.model.configuration import LimitFault, limit_faults
from guidefield.robot.model.model import JointKind, RobotModel


def refused_ahead(request: PlanRequest, problem: Problem, preparing: Told) -> Plan | None:
    """The plan of a problem that can't begin; None where it can.

    Args:
        request: What is asked.
        problem: The same for the planner.
        preparing: Told which part of the robot is prepared.
    """
    return _refusal(problem) or _unprepared(request, problem, preparing)


def connects(request: PlanRequest) -> bool:
    """Whether a plan certainly needs a connection by lanes."""
    return not isinstance(request.goal, requests.GuidePlaneGoal)


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


def _unprepared(request: PlanRequest, problem: Problem, preparing: Told) -> Plan | None:
    """Prepare the scene, and the robot if it connects; the plan if time was up before, None if it wasn't."""
    if problem.scene.moves and not connects(request):
        return None
    robot = problem.group.robot if connects(request) else None
    field = bool(problem.guide_planes) or request.guide_planes == "auto"
    try:
        prepare_in_time(robot, problem.scene, problem.budget.spent, preparing, field=field)
        if robot is not None:
            lay_out_in_time(problem.world, problem.budget.spent)
    except StoppedError as stopped:
        message = (
            "the first use of a robot or scene prepares its meshes, and time was up before"
            f" {stopped}; what is prepared is kept: ask again, or allow more time for the first plan"
        )
        details = {"stage": "load", "preparing": str(stopped)}
        return unprepared(problem, problem.budget.spent() or Status.TIMED_OUT, message, details)
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
