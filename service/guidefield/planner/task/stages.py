"""The stages of a plan as they run, with their times and outcomes; the endings of plans that fail, as sentences.

Statuses, stages' names and keys of details are the wire's; sentences may change, for people alone read them.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from guidefield.collision.clearance import clearance_at
from guidefield.deadline import end_reason, working_time
from guidefield.errors import Status
from guidefield.planner.task.problem import Conditions, Problem
from guidefield.planner.task.trace import StageEntered, StageLeft
from guidefield.prove.verdict import Reason, Verdict
from guidefield.robot.group.group import PlanningGroup


@dataclass(frozen=True, eq=False)
class Ending:
    """The end of a plan, or of a stage of it."""

    status: Status
    message: str
    details: dict[str, Any] = field(default_factory=dict)


SLACK = 1e-3
"""A refused motion whose distance is below the required clearance plus this counts as too close [m].

It chooses the status of a refusal, CLEARANCE_BELOW_MINIMUM, with its sentence and details, and nothing else.
"""


def describe_kept(min_clearance: float) -> str:
    """Say what two bodies do that keep a clearance [m]."""
    return f"keep {1000 * min_clearance:g} mm" if min_clearance > 0.0 else "don't touch"


def make_stopped_message(status: Status, plane: str, distance: float) -> str:
    """The message for a plan that was stopped on its way to a guide plane.

    Args:
        distance: Of the tip to it [m].
    """
    where = f"{1000 * distance:.0f} mm before guide plane {plane!r}"
    if status is Status.PREEMPTED:
        return f"the run was cancelled {where}"
    return f"time was up {where}; a longer `allowed_planning_time` lets it go on"


def describe_refused_place(group: PlanningGroup, verdict: Verdict) -> dict[str, Any]:
    """The details of a refusal by a verdict: pair, configuration, the joint that is beyond its limits."""
    details: dict[str, Any] = {"stage": "certify", "pair": list(verdict.pair) if verdict.pair else None}
    if verdict.local_point is not None:
        columns = group.wire_positions(verdict.local_point)
        details["configuration"] = dict(zip(group.position_names, columns, strict=True))
    if (fault := verdict.beyond) is not None:
        limits = {"joint": fault.joint, "value": fault.value, "limits": [fault.lower, fault.upper]}
        details |= limits | {"excess": fault.excess}
    return details


def make_refusal(conditions: Conditions, verdict: Verdict) -> Ending:
    """The ending of a motion that is not certified, with its reason and place."""
    status = conditions.deadline.status() or Status.INVALID_MOTION_PLAN
    pair = " and ".join(verdict.pair) if verdict.pair else "bodies"
    between = f" between {pair}" if verdict.pair else ""
    message = f"the certificate refused the motion: {verdict.reason.value}{between}"
    details = describe_refused_place(conditions.group, verdict)
    if verdict.local_point is None:
        return Ending(status, message, details)
    group = conditions.group
    if verdict.reason is Reason.STOPPED:
        return Ending(status, f"{end_reason(status)} before the motion was certified", details)
    if (fault := verdict.beyond) is not None:
        rate = "" if verdict.reason is Reason.BEYOND_LIMITS else f"as it is executed it is {verdict.reason.value}: "
        message = (
            f"the certificate refused the motion: {rate}joint {fault.joint} reaches {fault.value:.6g},"
            f" {fault.excess:.3g} beyond its limits [{fault.lower:.6g}, {fault.upper:.6g}]"
        )
        return Ending(status, message, details)
    if verdict.reason is Reason.UNDECIDED and conditions.execution is not None and conditions.execution.has_tube:
        message = (
            "the certificate refused the motion: where the execution may be, by its tolerance or between its ticks, it"
            f" can't be determined that {pair} {describe_kept(conditions.min_clearance)}"
        )
        return Ending(status, message, details)
    distance = clearance_at(conditions.world, group.expand_from_local(verdict.local_point)).obstacle_distance
    if status is Status.INVALID_MOTION_PLAN and 0.0 < distance < conditions.min_clearance + SLACK:
        message = (
            f"no motion was found that keeps {1000 * conditions.min_clearance:.1f} mm from the obstacles; this one"
            f" comes within {1000 * distance:.1f} mm between {pair}"
        )
        measured = {"clearance": distance, "min_clearance": conditions.min_clearance}
        return Ending(Status.CLEARANCE_BELOW_MINIMUM, message, details | measured)
    return Ending(status, message, details)


def make_ending_at_rest(problem: Problem, ending: Ending) -> Ending:
    """Say that an ending holds for the obstacles after they came to rest; the same where none moves."""
    if not problem.scene.moves:
        return ending
    end = problem.began + problem.scene.end
    message = f"as the obstacles stand from {end:.2f} s on: {ending.message}"
    return Ending(ending.status, message, {**ending.details, "time": end})


class StageFailed(Exception):
    """An end of the motion is none: nothing was found, so no path belongs to it."""

    def __init__(self, status: Status, message: str, **details: Any) -> None:
        super().__init__(message)
        self.ending = Ending(status, message, details)


@dataclass
class Stage:
    """A stage under way; its runner says how it ended."""

    outcome: str = ""


class Stages:
    """The times and outcomes of stages, which also go to the observer.

    A stage begins where the one before ended, the first where this is made: the time between them is counted, too.
    """

    def __init__(self, conditions: Conditions) -> None:
        self._conditions = conditions
        self._ended = working_time()
        self._within = 0
        self.left: list[StageLeft] = []
        self.seconds: dict[str, float] = {}

    @contextmanager
    def enter(self, name: str, message: str, plane: int | None = None) -> Iterator[Stage]:
        """Run a stage: its time is counted under its name, and its end is reported however it ends."""
        begin = working_time() if self._within else self._ended
        self._conditions.tell(StageEntered(name, message))
        stage = Stage()
        self._within += 1
        try:
            yield stage
        except StageFailed as failed:
            stage.outcome = stage.outcome or failed.ending.message
            raise
        finally:
            self._within -= 1
            self._ended = working_time()
            seconds = self._ended - begin
            self.seconds[name] = self.seconds.get(name, 0.0) + seconds
            left = StageLeft(name, stage.outcome, seconds, plane)
            self.left.append(left)
            self._conditions.tell(left)
