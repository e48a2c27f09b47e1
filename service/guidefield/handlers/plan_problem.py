"""From a plan request to the planner's problem; what is ill-posed is refused here, by the name of its field.

The certificate takes conditions (scene, clearance, allowed pairs, limits) from the problem as it is built here.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from guidefield.collision.world import World
from guidefield.deadline import Deadline
from guidefield.errors import InvalidConfiguration, InvalidGoal, MalformedRequest, at_path
from guidefield.geometry.surfaces import se3
from guidefield.handlers.asked_group import (
    cartesian_limits_of,
    clamp_slight,
    constraints_of,
    effort_limit_of,
    execution_of,
    goal_positions,
    jerk_limits,
    limit_group,
    rates_of,
    start_of,
    warn_of_clamped_goals,
    warn_of_missing_masses,
)
from guidefield.handlers.attached import holding
from guidefield.kernel_wait import working_time
from guidefield.messages import requests
from guidefield.messages.requests import GuidePlaneGoal, PlanRequest
from guidefield.planner.guide.auto_planes import derive_planes
from guidefield.planner.plan import Plan
from guidefield.planner.task.problem import ConfigurationGoal, Goal, LastPlaneGoal, Objective, Problem, TipGoal
from guidefield.planner.task.trace import StageLeft
from guidefield.potential import Precision, RobotField
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.kinematics import Kinematics
from guidefield.robot.group.reduced_model import select
from guidefield.robot.ik.inverse_kinematics import PoseTarget
from guidefield.robot.model.configuration import configuration_from_wire, limit_faults
from guidefield.robot.model.model import JointKind, RobotModel
from guidefield.robot.model.spaces import Configuration
from guidefield.scene import guide_plane
from guidefield.scene.guide_plane import GuidePlane
from guidefield.scene.scene import Scene


def given_planes(request: PlanRequest, scene: Scene, deadline: Deadline) -> tuple[GuidePlane, ...]:
    """The request's planes, else the scene's; none for planner "tree".

    Where planes are to be derived, there are none but the last of the scene's, if it is the goal.

    Raises SceneInvalid if a plane of the request isn't flat, isn't convex or has no area; DeadlineExpired if time was
    up before planes of many corners were built.
    """
    if request.planner == "tree":
        return ()
    if isinstance(request.guide_planes, list):
        return guide_plane.build_all(request.guide_planes, deadline)
    if request.guide_planes == "auto":
        return scene.guide_planes[-1:] if isinstance(request.goal, GuidePlaneGoal) else ()
    return scene.guide_planes


@dataclass(frozen=True)
class Derivation:
    """The outcome of deriving guide planes, the first stage of a plan; None if none were asked for."""

    left: StageLeft | None = None
    warning: str | None = None

    def add_to(self, made: Plan) -> Plan:
        """Return a plan with this stage before its own."""
        if self.left is None:
            return made
        seconds = {**made.seconds, "guide": made.seconds.get("guide", 0.0) + self.left.seconds}
        warnings = made.warnings if self.warning is None else (*made.warnings, self.warning)
        return dataclasses.replace(made, stages=(self.left, *made.stages), seconds=seconds, warnings=warnings)


def with_derived_planes(problem: Problem, request: PlanRequest) -> tuple[Problem, Derivation]:
    """The problem with guide planes derived, if the request asks for that: among obstacles as they come to rest."""
    if request.guide_planes != "auto" or request.planner == "tree":
        return problem, Derivation()
    begin = working_time()
    planes = derive_planes(problem.at(problem.scene.end), _goal_place(problem))
    seconds = working_time() - begin
    if planes is None:
        warning = (
            "no guide planes could be derived: the tip alone finds no way to the goal, or an end of it is in contact"
        )
        return problem, Derivation(StageLeft("guide", "no guide planes derived", seconds), warning)
    left = StageLeft("guide", f"derived {len(planes)} guide planes", seconds)
    together = dataclasses.replace(problem, guide_planes=(*planes, *problem.guide_planes), derived_planes=len(planes))
    return together, Derivation(left)


def _goal_place(problem: Problem) -> np.ndarray | GuidePlane:
    if isinstance(problem.goal, ConfigurationGoal):
        return problem.kinematics.tip_position(problem.group.expand(problem.goal.configurations[0]))
    if isinstance(problem.goal, TipGoal):
        return np.array(problem.goal.target.placement.translation)
    return problem.guide_planes[-1]


GOALS_PER_CHECK = 500  # goals read between two looks at the deadline: some milliseconds


def problem_of(
    request: PlanRequest, robot: RobotModel, scene: Scene, deadline: Deadline
) -> tuple[Problem, tuple[str, ...]]:
    """Build a request's problem, without derived guide planes, and warnings about harmless peculiarities.

    Raises InvalidGroup, InvalidGoal, InvalidConfiguration, UnknownFrame, UnknownObject, SceneInvalid if the question is
    ill-posed; MalformedRequest if it asks for what this version doesn't serve; DeadlineExpired if time was up before
    its guide planes were built, or its many goals were read.
    """
    robot = holding(robot, request.attached_objects, scene, deadline)
    q_whole, warnings = start_of(request.start, robot)
    root = request.robot_placement
    group = select(robot, request.group, request.tip, q_whole, se3(root.position, root.quaternion_xyzw))
    group = limit_group(group.starting_at(request.start), request)
    planes = given_planes(request, scene, deadline)
    if request.path_constraints and request.planner == "guided":
        raise MalformedRequest("path constraints are kept by connections: planner 'guided' makes none, 'auto' does")
    if in_motion(request):
        _require_served_in_motion(request, group, planes)
    problem = Problem(
        group=group,
        scene=scene,
        world=World.build(group, scene, request.allowed_collisions),
        robot_field=RobotField(group, scene, Precision.SINGLE),
        kinematics=Kinematics(group),
        q_start=group.part_of(q_whole),
        goal=_goal(request, group, planes, deadline),
        guide_planes=planes,
        min_clearance=request.min_clearance,
        allowed_collisions=frozenset(request.allowed_collisions),
        path_constraints=constraints_of(request, group),
        execution=execution_of(request, group),
        cartesian_limits=cartesian_limits_of(request, group),
        effort_limit=effort_limit_of(request, group),
        leave_start_contact=request.leave_start_contact,
        jerk_limits=jerk_limits(group, request),
        optimization_iterations=request.optimization_iterations,
        start_velocity=rates_of(request.start_velocities, "start_velocities", group),
        start_acceleration=rates_of(request.start_accelerations, "start_accelerations", group),
        end_velocity=rates_of(request.end_velocities, "end_velocities", group),
        objective=Objective(request.objective),
        seed=request.seed,
        deadline=deadline,
    )
    return problem, (
        *robot.warnings,
        *scene.warnings,
        *warnings,
        *warn_of_clamped_goals(request.goal, robot),
        *warn_of_many_turns(request, robot),
        *warn_of_missing_masses(request),
    )


def in_motion(request: PlanRequest) -> bool:
    """Return whether a request's motion begins or ends in motion."""
    asked = (request.start_velocities, request.start_accelerations, request.end_velocities)
    return any(any(rates.values()) for rates in asked)


def _require_served_in_motion(request: PlanRequest, group: PlanningGroup, planes: tuple[GuidePlane, ...]) -> None:
    if not group.is_euclidean:
        several = [joint.name for joint in group.joints if joint.nv > 1]
        raise InvalidConfiguration(
            "velocities and accelerations at the ends are served for joints of one coordinate, and planned for is"
            f" {', '.join(several)}",
            joints=several,
        )
    asks_for_planes = request.guide_planes == "auto" and request.planner != "tree"
    unserved = {
        "path_constraints": (bool(request.path_constraints), "leave them out"),
        "leave_start_contact": (request.leave_start_contact, "leave it out"),
        "guide_planes": (bool(planes) or asks_for_planes, "give them as []"),
    }
    for what, (asked, instead) in unserved.items():
        if asked:
            raise MalformedRequest(
                f"with velocities or accelerations at the ends `{what}` is not served: {instead}",
                unserved=what,
                path=f"$.{what}",
            )
    if any(request.end_velocities.values()) and not isinstance(
        request.goal, requests.JointsGoal | requests.JointSetGoal
    ):
        raise MalformedRequest(
            "`end_velocities` need a `goal` of type 'joints' or 'joint_set'", path="$.end_velocities"
        )


def _why_no_plane(request: PlanRequest) -> str:
    if request.planner == "tree":
        return "planner 'tree' uses none"
    if request.guide_planes == []:
        return "`guide_planes` is empty; null takes the scene's"
    return "the scene has none; give some in `guide_planes`"


def _goal(request: PlanRequest, group: PlanningGroup, planes: tuple[GuidePlane, ...], deadline: Deadline) -> Goal:
    goal = request.goal
    assert goal is not None, "a request with steps has one for each of them"
    if isinstance(goal, requests.GuidePlaneGoal):
        if not planes:
            raise InvalidGoal(f"the goal is the last guide plane, but there is none: {_why_no_plane(request)}")
        return LastPlaneGoal()
    if request.planner == "guided":
        raise InvalidGoal(
            "planner 'guided' takes only a goal of type 'guide_plane'; 'auto' goes on to configurations and poses"
        )
    if isinstance(goal, requests.PoseGoal):
        return TipGoal(PoseTarget.from_wire(goal))
    of_set = isinstance(goal, requests.JointSetGoal)
    configurations: list[Configuration] = []
    for index, positions in enumerate(goal_positions(goal)):
        if len(configurations) % GOALS_PER_CHECK == GOALS_PER_CHECK - 1:
            deadline.check("the goals were read")
        with at_path(f"$.goal.positions[{index}]" if of_set else "$.goal.positions"):
            configurations.append(_goal_configuration(group, positions))
    # beyond a limit only counts where no other goal is left: then it is the reason of the refusal
    within = tuple(q for q in configurations if not limit_faults(group.joints, q))
    return ConfigurationGoal(within or tuple(configurations))


def _goal_configuration(group: PlanningGroup, positions: requests.Positions) -> Configuration:
    planned = {joint.name for joint in group.joints}
    q = configuration_from_wire(group.robot, positions, base=group.q_reference, error=InvalidGoal)
    for name in positions:
        if name not in planned:
            raise InvalidGoal(
                f"the goal gives joint {name!r}, which is not planned for; planned are {', '.join(sorted(planned))}",
                joint=name,
                available=sorted(planned),
                path=f"$.{name}",
            )
    return group.part_of(clamp_slight(group.robot, q))


HARDLY_RADIANS = 4.0 * math.pi
"""A goal that is further from the start was probably given in degrees [rad]: no whole turn is ever needed."""


def warn_of_many_turns(request: PlanRequest, robot: RobotModel) -> list[str]:
    """Warn about each continuous joint whose goal is further than `HARDLY_RADIANS` from its start.

    A joint with limits needs none: there such a goal is refused.
    """
    warnings: dict[str, str] = {}
    for positions in goal_positions(request.goal):
        for name, value in positions.items():
            joint, start = robot.joint(name), request.start.get(name, 0.0)
            if joint is None or joint.kind is not JointKind.CONTINUOUS or isinstance(value, list):
                continue
            if not isinstance(start, list) and (away := abs(value - start)) > HARDLY_RADIANS:
                turns = f"{value:g} is {away / (2.0 * math.pi):.1f} turns from the start"
                warnings[name] = f"the goal of joint {name!r} is hardly in radians: {turns}"
    return list(warnings.values())
