"""The plan request: from the message to the planner's problem, and from the plan to the reply."""

from __future__ import annotations

import contextlib
import dataclasses
import time
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from guidefield.collision.preparation import StoppedError, Told, needs_preparation, prepare
from guidefield.collision.world import World
from guidefield.errors import GuidefieldError, InvalidConfiguration, InvalidGoal, MalformedRequest, Status
from guidefield.geometry.placements import se3
from guidefield.handlers.attached import holding
from guidefield.handlers.constraints import constraints_of
from guidefield.handlers.plan_reply import reply_to
from guidefield.handlers.planes import Derivation, given_planes, with_derived_planes
from guidefield.messages import requests
from guidefield.messages.replies import PlanReply
from guidefield.messages.requests import PlanRequest
from guidefield.planner.attempts import ATTEMPTS
from guidefield.planner.plan import Plan, Planner, plan, refused
from guidefield.planner.problem import Budget, ConfigurationGoal, Goal, LastPlaneGoal, Problem, TipGoal
from guidefield.planner.quality import ClearanceProfile, clearance_profile
from guidefield.planner.trace import Event, Silent
from guidefield.potential import Precision, RobotField
from guidefield.robot.configuration import LIMIT_TOLERANCE, LimitFault, clamp, configuration_from_wire, limit_faults
from guidefield.robot.group import PlanningGroup
from guidefield.robot.inverse_kinematics import PoseTarget
from guidefield.robot.kinematics import Kinematics
from guidefield.robot.model import RobotModel
from guidefield.robot.selection import select
from guidefield.scene.guide_plane import GuidePlane
from guidefield.scene.scene import Scene


class Recording(Protocol):
    """Somebody who records a run: an observer who is told the end."""

    def observe(self, event: Event) -> None:
        """Be told of an event."""

    def finish(self, reply: PlanReply, profile: ClearanceProfile | None) -> None:
        """Be told the end, and write."""


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
    _require_served(request, scene)
    robot = holding(robot, request.attached_objects, scene)
    q_whole, warnings = _start(request, robot)
    group = select(
        robot,
        request.group,
        request.tip,
        q_whole,
        se3(request.robot_placement.position, request.robot_placement.quaternion_xyzw),
    )
    group = _limited(group, request)
    attempts = ATTEMPTS[request.minimizer](group)
    planes = given_planes(request, scene)
    if request.path_constraints and (planes or (request.guide_planes == "auto" and request.planner != "tree")):
        raise MalformedRequest("path constraints are served without guide planes: give `guide_planes` as []")
    problem = Problem(
        group=group,
        scene=scene,
        world=World.build(group, scene, request.allowed_collisions),
        robot_field=RobotField(group, scene, Precision.SINGLE),
        kinematics=Kinematics(group),
        q_start=group.part_of(q_whole),
        goal=_goal(request, group, planes),
        guide_planes=planes,
        min_clearance=request.min_clearance,
        allowed_collisions=tuple((first, second) for first, second in request.allowed_collisions),
        path_constraints=constraints_of(request, group),
        leave_start_contact=request.leave_start_contact,
        jerk_limits=_jerk_limits(group, request),
        optimization_iterations=request.optimization_iterations,
        seed=request.seed,
        budget=Budget(received + request.allowed_planning_time, cancelled),
    )
    refusal = _refusal(problem) or _unprepared(request, problem, preparing)
    load_seconds = time.monotonic() - began
    derivation = Derivation()
    if refusal is None:
        problem, derivation = with_derived_planes(problem, request)
    begin = time.monotonic()
    recording = record(group, scene, problem.guide_planes)
    load_seconds += time.monotonic() - begin
    problem = dataclasses.replace(problem, observer=recording or Silent())
    made = derivation.told_in(refusal or plan(problem, Planner(request.planner), attempts))
    profile, begin = None, time.monotonic()
    if made.trajectory is not None:
        profile = clearance_profile(made.trajectory, problem)
    measured = time.monotonic() - begin
    reply = reply_to(request, problem, made, profile, run_id, received, load_seconds, measured, warnings)
    if recording is not None:
        recording.finish(reply, profile)
    return reply


def _require_served(request: PlanRequest, scene: Scene) -> None:
    """Refuse what is part of the wire but not of this version, by name."""
    unserved = {
        "path_constraints among obstacles that move": scene.moves and bool(request.path_constraints),
        "leave_start_contact among obstacles that move": scene.moves and request.leave_start_contact,
        "moving obstacles with goals other than the last guide plane": scene.moves
        and not isinstance(request.goal, requests.GuidePlaneGoal),
        "jerk limits among obstacles that move": scene.moves
        and any(limits.jerk is not None for limits in request.limits.values()),
    }
    for what, asked in unserved.items():
        if asked:
            raise MalformedRequest(f"this version does not serve {what} yet; leave it out", unserved=what)


def _start(request: PlanRequest, robot: RobotModel) -> tuple[np.ndarray, list[str]]:
    """The start of the whole robot, clamped where it was beyond a limit by next to nothing, and warnings about that."""
    q = configuration_from_wire(robot, request.start)
    warnings = [
        f"start {fault.joint} was {fault.excess:.2g} beyond its limit and was clamped"
        for fault in limit_faults(robot.joints, q)
        if fault.excess <= LIMIT_TOLERANCE
    ]
    return (clamp_slight(robot, q) if warnings else q), warnings


def clamp_slight(robot: RobotModel, q: np.ndarray) -> np.ndarray:
    """The configuration with values beyond a limit by at most `LIMIT_TOLERANCE` brought back to it.

    Args:
        robot: Whose limits.
        q: Configuration of the whole robot, shape (nq,) [rad or m].

    Returns:
        Shape (nq,).
    """
    slight = [j for f in limit_faults(robot.joints, q) if f.excess <= LIMIT_TOLERANCE and (j := robot.joint(f.joint))]
    return clamp(slight, q)


def _limited(group: PlanningGroup, request: PlanRequest) -> PlanningGroup:
    names = [joint.name for joint in group.joints]
    for name in request.limits:
        if name not in names:
            raise InvalidConfiguration(
                f"`limits` names joint {name!r}, which is not planned for; planned are {', '.join(names)}",
                joint=name,
                available=names,
            )
    return group.with_limits(
        {name: limits.velocity for name, limits in request.limits.items() if limits.velocity is not None},
        {name: limits.acceleration for name, limits in request.limits.items() if limits.acceleration is not None},
        request.max_velocity_scaling_factor,
        request.max_acceleration_scaling_factor,
    )


def _jerk_limits(group: PlanningGroup, request: PlanRequest) -> np.ndarray | None:
    asked = {name: limits.jerk for name, limits in request.limits.items() if limits.jerk is not None}
    if not asked:
        return None
    return np.concatenate([np.full(joint.nv, asked.get(joint.name, np.inf)) for joint in group.joints])


def _goal(request: PlanRequest, group: PlanningGroup, planes: tuple[GuidePlane, ...]) -> Goal:
    goal = request.goal
    if isinstance(goal, requests.GuidePlaneGoal):
        if not planes:
            why = (
                "planner 'tree' uses none" if request.planner == "tree" else "neither the request nor the scene has one"
            )
            raise InvalidGoal(f"the goal is the last guide plane, but there is none: {why}")
        return LastPlaneGoal()
    if request.planner == "guided":
        raise InvalidGoal(
            "planner 'guided' takes only a goal of type 'guide_plane'; 'auto' goes on to configurations and poses"
        )
    if isinstance(goal, requests.PoseGoal):
        return TipGoal(PoseTarget.from_wire(goal))
    many = goal.positions if isinstance(goal, requests.JointSetGoal) else [goal.positions]
    configurations = tuple(_goal_configuration(group, positions) for positions in many)
    # beyond a limit only counts where no other goal is left: then it is the reason of the refusal
    within = tuple(q for q in configurations if not limit_faults(group.joints, q))
    return ConfigurationGoal(within or configurations)


def _goal_configuration(group: PlanningGroup, positions: requests.Positions) -> np.ndarray:
    planned = {joint.name for joint in group.joints}
    q = configuration_from_wire(group.robot, positions, base=group.q_reference, error=InvalidGoal)
    for name in positions:
        if name not in planned:
            raise InvalidGoal(
                f"the goal gives joint {name!r}, which is not planned for; planned are {', '.join(sorted(planned))}",
                joint=name,
                available=sorted(planned),
            )
    return group.part_of(clamp_slight(group.robot, q))


def _refusal(problem: Problem) -> Plan | None:
    """The plan of a problem whose start or goal is beyond a joint limit; None where they are not."""
    faults = limit_faults(problem.group.robot.joints, problem.group.q_reference)
    if faults:
        return refused(problem, Status.START_STATE_INVALID, *_limit_message("start", faults))
    if isinstance(problem.goal, ConfigurationGoal):
        faults = limit_faults(problem.group.joints, problem.goal.configurations[0])
        if faults:
            return refused(problem, Status.GOAL_STATE_INVALID, *_limit_message("goal", faults))
    return None


def prepare_ahead(request: PlanRequest, load: Callable[[requests.RobotReference], RobotModel]) -> None:
    """Prepare a request's robot before its time begins. What can't be used is refused later, where that is kept."""
    with contextlib.suppress(GuidefieldError):
        robot = load(request.robot)
        base = request.robot_placement
        group = select(robot, request.group, request.tip, robot.rest, se3(base.position, base.quaternion_xyzw))
        if _connects(request) and needs_preparation(group):
            prepare(robot)


def _connects(request: PlanRequest) -> bool:
    """Whether a plan certainly needs a connection by lanes."""
    return not (isinstance(request.goal, requests.GuidePlaneGoal) or request.path_constraints)


def _unprepared(request: PlanRequest, problem: Problem, preparing: Told) -> Plan | None:
    """Prepare the robot if a connection needs it; the plan if time was up before that, None if it wasn't."""
    if not _connects(request) or not needs_preparation(problem.group):
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


def _limit_message(end: str, faults: list[LimitFault]) -> tuple[str, dict[str, Any]]:
    fault = faults[0]
    more = f" (and {len(faults) - 1} more joints)" if len(faults) > 1 else ""
    return (
        f"the {end} has joint {fault.joint} at {fault.value:.6g}, outside its limits"
        f" [{fault.lower:.6g}, {fault.upper:.6g}]{more}",
        {"stage": end, "joint": fault.joint, "value": fault.value, "limits": [fault.lower, fault.upper]},
    )
