"""The service `plan_kinematic_path`: a moveit_msgs/GetMotionPlan to a plan request of ours, our reply to its response.

If goals are alternative poses, `services.py` asks for configurations at them first: requests of ours have one pose.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import msgspec

from guidefield.endpoint.ros.constraints import RequestedGoal, goal_of, path_constraints_of
from guidefield.endpoint.ros.refusals import GoalRefused, Refused, StateRefused, moveit_code, number
from guidefield.endpoint.ros.robot_messages import error_code, robot_state, robot_trajectory
from guidefield.endpoint.ros.snapshot import Snapshot, with_state
from guidefield.errors import Status
from guidefield.messages.conditions import CartesianLimit
from guidefield.messages.kinematics import InverseKinematicsReply
from guidefield.messages.plan_reply import PlanReply
from guidefield.messages.requests import InverseKinematics, PlanRequest, TargetPose
from guidefield.messages.values import LONGEST_TIME, JointSetGoal, JointsGoal, PoseGoal

# docs/ros.md tells all three
UNSET_TIME = 1.0  # the planning time if a request has none, as in MoveIt [s]
REST_SPEED = 1e-3
"""A joint slower than this at the start, planned or not, is at rest: measured velocities are never 0 [rad/s or m/s]."""
SOLUTIONS = 8  # number of configurations that are searched at each of several poses


@dataclass(frozen=True)
class RequestedPlan:
    """A GetMotionPlan as it is read."""

    request: PlanRequest  # as a plan request of ours
    start: Snapshot  # robot and scene when it begins
    group: str  # the group's name
    notes: tuple[str, ...]  # sentences about values that were changed or ignored
    choices: tuple[RequestedGoal, ...] = ()  # alternative goals with poses among them; empty if the request holds all


def read_plan_request(message: Any, now: Snapshot) -> RequestedPlan:
    """Read a GetMotionPlan; raises Refused, with the name of the field, if it isn't served."""
    ros_request = message.motion_plan_request
    group = now.robot.group(ros_request.group_name)
    _require_served(ros_request)
    start = with_state(now, ros_request.start_state, "start_state")
    goal = goal_of(ros_request.goal_constraints, group, start)
    allowed, time_notes = _planning_time(ros_request.allowed_planning_time)
    velocity, velocity_notes = _factor(ros_request.max_velocity_scaling_factor, "max_velocity_scaling_factor")
    acceleration, acceleration_notes = _factor(
        ros_request.max_acceleration_scaling_factor, "max_acceleration_scaling_factor"
    )
    request = PlanRequest(
        robot=start.robot.name,
        scene=start.scene(),
        goal=goal.goal,
        group=group,
        tip=goal.tip,
        start=dict(start.whole),
        start_velocities=_start_velocities(ros_request.start_state.joint_state, group),
        guide_planes=[],
        attached_objects=start.attached(),
        allowed_collisions=start.allowed(),
        path_constraints=path_constraints_of(ros_request.path_constraints, group, start),
        cartesian_limits=_cartesian_limits(ros_request, goal.tip, start),
        max_velocity_scaling_factor=velocity,
        max_acceleration_scaling_factor=acceleration,
        allowed_planning_time=allowed,
    )
    notes = (
        *_start_notes(start),
        *goal.notes,
        *time_notes,
        *velocity_notes,
        *acceleration_notes,
        *_list_ignored(ros_request),
    )
    return RequestedPlan(request, start, ros_request.group_name, notes, (goal, *goal.others) if goal.others else ())


def request_solutions(plan: RequestedPlan) -> list[InverseKinematics]:
    """Return requests for configurations at the poses of alternative goals, one for each link.

    MoveIt's planners sample such configurations, too.
    """
    request = plan.request
    poses: dict[str, list[TargetPose]] = {}
    for one in plan.choices:
        if isinstance(one.goal, PoseGoal):
            assert one.tip is not None, "a pose is a link's"
            poses.setdefault(one.tip, []).append(TargetPose(**msgspec.structs.asdict(one.goal)))
    return [
        InverseKinematics(
            robot=request.robot,
            poses=targets,
            tip=tip,
            group=request.group,
            scene=request.scene,
            collision_free=True,
            attached_objects=request.attached_objects,
            allowed_collisions=request.allowed_collisions,
            start_configurations=[request.start],
            solutions=SOLUTIONS,
            allowed_time=request.allowed_planning_time,
        )
        for tip, targets in poses.items()
    ]


def with_solutions(plan: RequestedPlan, found: Sequence[InverseKinematicsReply]) -> RequestedPlan:
    """Return the plan with the found configurations, and alternative goals of joints, as its goal.

    Raises Refused if there are none.
    """
    positions = [one.goal.positions for one in plan.choices if isinstance(one.goal, JointsGoal)]
    positions += [solution for reply in found for solutions in reply.configurations for solution in solutions]
    if not positions:
        reasons = "; ".join(dict.fromkeys(reason for reply in found for reason in reply.reasons))
        raise Refused(f"`goal_constraints`: none of the poses is reached: {reasons}", Status.NO_IK_SOLUTION)
    note = f"of {len(plan.choices)} goals {len(positions)} configurations were looked at"
    goal = JointSetGoal(positions)
    return dataclasses.replace(
        plan, request=msgspec.structs.replace(plan.request, goal=goal, tip=None), notes=(*plan.notes, note)
    )


def plan_response(plan: RequestedPlan, reply: PlanReply, seconds: float) -> dict[str, Any]:
    """Return the response of a reply; it has a trajectory only if that is whole and certified."""
    code = moveit_code(reply.status.code)
    answer = {
        "trajectory_start": robot_state(plan.start),
        "group_name": plan.group,
        "planning_time": seconds,
        "error_code": error_code(code, _describe(reply, plan.notes)),
    }
    if code == Status.SUCCESS:
        assert reply.trajectory is not None, "a plan that was found has one"
        answer["trajectory"] = robot_trajectory(plan.start, reply.position_names, reply.trajectory)
    return {"motion_plan_response": answer}


def display(plan: RequestedPlan, response: dict[str, Any]) -> dict[str, Any]:
    """Return the moveit_msgs/DisplayTrajectory of the response with a trajectory."""
    answer = response["motion_plan_response"]
    return {
        "model_id": plan.start.robot.name,
        "trajectory": [answer["trajectory"]],
        "trajectory_start": answer["trajectory_start"],
    }


def _describe(reply: PlanReply, notes: tuple[str, ...]) -> str:
    name = "" if reply.status.name == moveit_code(reply.status.code).name else f"{reply.status.name}: "
    parts = [f"{name}{reply.status.message}"]
    if (found := reply.clearance) is not None and found.minimum is not None and found.pair is not None:
        parts.append(f"clearance {found.minimum:.4g} m ({' and '.join(found.pair)})")
    parts.append(f"run {reply.run_id}")
    return "; ".join([*parts, *notes, *reply.warnings])


def _require_served(ros_request: Any) -> None:
    if ros_request.trajectory_constraints.constraints:
        raise GoalRefused("`trajectory_constraints` isn't served")


def _cartesian_limits(ros_request: Any, tip: str | None, start: Snapshot) -> list[CartesianLimit]:
    speed, link = (
        number(ros_request.max_cartesian_speed, "max_cartesian_speed"),
        ros_request.cartesian_speed_limited_link,
    )
    if speed <= 0.0:
        return []
    if link:
        start.robot.require_link(link, "cartesian_speed_limited_link")
    return [CartesianLimit(speed=speed, frame=link or tip or start.robot.model.tip)]


def _factor(value: float, field: str) -> tuple[float, tuple[str, ...]]:
    if value == 0.0:
        return 1.0, (f"`{field}` is unset and means 1",)
    if not 0.0 < value <= 1.0:
        raise Refused(f"`{field}` must be above 0 and at most 1, or 0 for 1; got {value}")
    return value, ()


def _planning_time(seconds: float) -> tuple[float, tuple[str, ...]]:
    number(seconds, "allowed_planning_time")
    if seconds <= 0.0:
        return UNSET_TIME, (f"`allowed_planning_time` is unset and means {UNSET_TIME:g} s",)
    if seconds > LONGEST_TIME:
        raise Refused(f"`allowed_planning_time` must be at most {LONGEST_TIME:g} s, got {seconds:g}")
    return seconds, ()


def _start_velocities(state: Any, group: Sequence[str]) -> dict[str, float]:
    field = "start_state.joint_state.velocity"
    names, values = state.name, state.velocity.tolist()
    if values and len(names) != len(values):
        raise StateRefused(f"`{field}` must have a value for each name, {len(names)}, or none, got {len(values)}")
    moving = {}
    for name, value in zip(names, values, strict=False):
        velocity = number(value, f"{field} of {name[:64]}", StateRefused)
        if abs(velocity) < REST_SPEED:
            continue
        if name not in group:
            raise StateRefused(
                f"`{field}`: {name[:64]} moves at {velocity:.6g}, and is no joint of the group: {', '.join(group)}"
            )
        moving[name] = velocity
    return moving


def _start_notes(start: Snapshot) -> list[str]:
    if not start.unheard:
        return []
    return [f"neither /joint_states nor `start_state` tells {', '.join(start.unheard)}: taken at rest"]


def _list_ignored(ros_request: Any) -> list[str]:
    ignored = {
        "pipeline_id": bool(ros_request.pipeline_id),
        "planner_id": bool(ros_request.planner_id),
        "num_planning_attempts": ros_request.num_planning_attempts > 1,
        "reference_trajectories": bool(ros_request.reference_trajectories),
    }
    names = ", ".join(f"`{name}`" for name, given in ignored.items() if given)
    return [f"{names} not used"] if names else []
