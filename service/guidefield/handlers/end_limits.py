"""Refusal of plans whose start or goal is beyond a joint limit."""

from __future__ import annotations

from typing import Any

from guidefield.errors import Status
from guidefield.planner.plan import Plan, refused
from guidefield.planner.task.problem import ConfigurationGoal, Problem
from guidefield.robot.model.configuration import LimitFault, limit_faults
from guidefield.robot.model.model import JointKind, RobotModel


def refuse_ends(problem: Problem) -> Plan | None:
    """Return the plan of a problem whose start or goal is beyond a joint limit; None if they are not."""
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
