"""The ending of a plan, or of a stage of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from guidefield.collision.clearance import clearance_at
from guidefield.deadline import end_reason
from guidefield.errors import Status
from guidefield.planner.task.conditions import Conditions
from guidefield.prove.verdict import Reason, Verdict
from guidefield.robot.group.group import PlanningGroup


@dataclass(frozen=True, eq=False)
class Ending:
    """How a plan, or a stage of it, ended."""

    status: Status
    message: str
    details: dict[str, Any] = field(default_factory=dict)


SLACK = 1e-3
"""A motion that is refused where it keeps the clearance asked for, and no more than this on top, is too close [m]."""


def stopped_before(status: Status, plane: str, distance: float) -> str:
    """What is told of a plan that was stopped on its way to a guide plane.

    Args:
        distance: Of the tip to it [m].
    """
    where = f"{1000 * distance:.0f} mm before guide plane {plane!r}"
    if status is Status.PREEMPTED:
        return f"the run was cancelled {where}"
    return f"time was up {where}; a longer `allowed_planning_time` lets it go on"


def refused_at(group: PlanningGroup, verdict: Verdict) -> dict[str, Any]:
    """What a verdict says about what was refused: pair, configuration, the joint that is beyond its limits."""
    details: dict[str, Any] = {"stage": "certify", "pair": list(verdict.pair) if verdict.pair else None}
    if verdict.chart_point is not None:
        columns = group.wire_positions(verdict.chart_point)
        details["configuration"] = dict(zip(group.position_names, columns, strict=True))
    if (fault := verdict.beyond) is not None:
        limits = {"joint": fault.joint, "value": fault.value, "limits": [fault.lower, fault.upper]}
        details |= limits | {"excess": fault.excess}
    return details


def refusal(conditions: Conditions, verdict: Verdict) -> Ending:
    """Why a motion is not certified, and where."""
    status = conditions.deadline.status() or Status.INVALID_MOTION_PLAN
    pair = " and ".join(verdict.pair) if verdict.pair else "bodies"
    between = f" between {pair}" if verdict.pair else ""
    message = f"the certificate refused the motion: {verdict.reason.value}{between}"
    details = refused_at(conditions.group, verdict)
    if verdict.chart_point is None:
        return Ending(status, message, details)
    group = conditions.group
    if verdict.reason is Reason.STOPPED:
        return Ending(status, f"{end_reason(status)} before the motion was certified", details)
    if (fault := verdict.beyond) is not None:
        message = (
            f"the certificate refused the motion: joint {fault.joint} reaches {fault.value:.6g},"
            f" {fault.excess:.3g} beyond its limits [{fault.lower:.6g}, {fault.upper:.6g}]"
        )
        return Ending(status, message, details)
    distance = clearance_at(conditions.world, group.expand_from_chart(verdict.chart_point)).obstacle_distance
    if status is Status.INVALID_MOTION_PLAN and 0.0 < distance < conditions.min_clearance + SLACK:
        message = (
            f"no motion was found that keeps {1000 * conditions.min_clearance:.1f} mm from the obstacles; this one"
            f" comes within {1000 * distance:.1f} mm between {pair}"
        )
        measured = {"clearance": distance, "min_clearance": conditions.min_clearance}
        return Ending(Status.CLEARANCE_BELOW_MINIMUM, message, details | measured)
    return Ending(status, message, details)
