"""A plan request's steps as the planner's `StepSequence`: each step is a plan request of its own."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import msgspec
import pinocchio as pin

from guidefield.collision.world import World
from guidefield.deadline import Deadline, working_time
from guidefield.errors import GuidefieldError, InvalidGroup, MalformedRequest, at_path
from guidefield.geometry.surfaces import se3, wire_pose
from guidefield.handlers.attached import HeldObject, StepSituation, holding, payload_inertia
from guidefield.handlers.plan import in_motion, problem_of, refuse_ends, with_derived_planes
from guidefield.handlers.preparation import Announce, prepare_problem
from guidefield.handlers.requested_group import (
    cartesian_limits_of,
    constraints_of,
    effort_limit_of,
    execution_of,
    jerk_limits,
    limit_group,
    mimic_laws,
    start_of,
    warn_of_clamped_goals,
)
from guidefield.messages import requests
from guidefield.messages.execution import ExecutionOptions
from guidefield.messages.requests import PlanRequest, PlanStep, RelativeGoal
from guidefield.planner.guide.guide import ATTEMPTS
from guidefield.planner.plan import Plan, Planner, plan
from guidefield.planner.sequence.cartesian_line import CartesianLine, straight_plan
from guidefield.planner.sequence.step_sequence import StepMotion
from guidefield.planner.task.problem import Conditions, Counters, Problem
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.reduced_model import select
from guidefield.robot.model.configuration import configuration_to_wire
from guidefield.robot.model.joints import JointKind, RobotConfiguration
from guidefield.robot.model.model import RobotModel
from guidefield.scene.scene import Scene

STEP_FIELDS = ("goal", "tip", "guide_planes", "attach", "detach", "cartesian_limits")
"""Fields of a step to which the path of a fault leads, `$.steps[i].goal`; of others it leads to the step."""
UNSERVED_KINDS = (JointKind.SPHERICAL, JointKind.FLOATING)
"""Kinds of joints whose local coordinates begin anew with every step, so that steps can't be joined in them."""


class Steps:
    """The steps of a request.

    Raises GuidefieldError as `problem_of`, with the step's path, where the question is ill-posed.
    """

    def __init__(
        self, request: PlanRequest, robot: RobotModel, scene: Scene, deadline: Deadline, preparing: Announce
    ) -> None:
        _require_served(request)
        self._request, self._deadline, self._preparing = request, deadline, preparing
        self.counters = Counters()
        base = request.robot_placement
        holding(robot, request.attached_objects, scene, deadline)  # refused here, as in any request
        q, self.warnings = start_of(request.start, robot)
        for index, step in enumerate(request.steps):
            self.warnings += [f"step {index}: {warning}" for warning in warn_of_clamped_goals(step.goal, robot)]
            if step.attach is not None and step.attach.mass is not None:
                with _in_step(index):
                    payload_inertia(step.attach.mass, step.attach.centre_of_mass, step.attach.inertia, "attach")
        objects = tuple(HeldObject(one) for one in request.attached_objects)
        self.start = StepSituation(robot, se3(base.position, base.quaternion_xyzw), scene, q, objects)
        self._moving = self._moving_joints()
        self.whole = self._group(robot, self.start.q, request)
        self.execution = execution_of(request, self.whole)
        self._require_passable()

    def __len__(self) -> int:
        return len(self._request.steps)

    def moves(self, index: int) -> bool:
        """As in `StepSequence`."""
        return self._request.steps[index].goal is not None

    def motion(self, index: int, at: StepSituation, begin: float) -> StepMotion | None:
        """As in `StepSequence`."""
        step = self._request.steps[index]
        if step.goal is None:
            return None
        request = self._make_request(index, at)
        with _in_step(index):
            problem, _ = problem_of(request, at.robot, at.scene.since(begin), self._deadline)
            if step.linear and not problem.group.is_euclidean:
                several = [joint.name for joint in problem.group.joints if joint.nv > 1]
                raise MalformedRequest(
                    f"`linear` is served for joints of one coordinate, and planned for is {', '.join(several)}",
                    joints=several,
                )
        problem = dataclasses.replace(problem, counters=self.counters, began=begin)
        line = _line(step, request, problem) if step.linear else None
        return StepMotion(problem, self._make_planner(request, line), line)

    def after(self, index: int, at: StepSituation, q: RobotConfiguration, time: float) -> StepSituation:
        """As in `StepSequence`."""
        step = self._request.steps[index]
        with _in_step(index):
            then = at.move(q, time, self._request.min_clearance)
            if step.detach is not None:
                with at_path("$.detach"):
                    then = then.without(step.detach)
            if step.attach is not None:
                with at_path("$.attach"):
                    then = then.holding(step.attach, then.link_of(self._tip(step)))
        return then

    def conditions(self, index: int, at: StepSituation) -> Conditions:
        """As in `StepSequence`."""
        request = self._limited_for(index)
        with _in_step(index):
            robot = holding(at.robot, [one.attached for one in at.objects], at.scene)
            group = self._group(robot, at.q, request)
            return Conditions(
                group=group,
                scene=at.scene,
                world=World.build(group, at.scene, self._request.allowed_collisions),
                min_clearance=self._request.min_clearance,
                allowed_collisions=frozenset(self._request.allowed_collisions),
                path_constraints=constraints_of(self._request, group),
                cartesian_limits=cartesian_limits_of(request, group),
                effort_limit=effort_limit_of(self._request, group),
                jerk_limits=jerk_limits(group, request),
                execution=self.execution,
                deadline=self._deadline,
                counters=self.counters,
            )

    def leaves_at(self, index: int, at: StepSituation, arrival: float) -> float:
        """As in `StepSequence`."""
        step = self._request.steps[index]
        return max(arrival + step.pause, 0.0 if step.attach is None else at.rests_from(step.attach.object))

    def passes(self, index: int) -> float | None:
        """As in `StepSequence`."""
        step = self._request.steps[index]
        return None if step.stop else step.radius

    def attached(self, index: int) -> str | None:
        """As in `StepSequence`."""
        attach = self._request.steps[index].attach
        return None if attach is None else attach.object

    def detached(self, index: int) -> str | None:
        """As in `StepSequence`."""
        return self._request.steps[index].detach

    def _moving_joints(self) -> list[str]:
        names, known = set[str](), list[tuple[str | list[str] | None, str]]()
        for index, step in enumerate(self._request.steps):
            selection = self._joints(step), self._tip(step)
            if step.goal is not None and selection not in known:
                known.append(selection)
                with _in_step(index):
                    part = select(self.start.robot, *selection, self.start.q, self.start.root)
                    names |= {joint.name for joint in part.joints}
        if not names:
            raise MalformedRequest("no step has a `goal`: nothing moves", path="$.steps")
        return [joint.name for joint in self.start.robot.joints if joint.name in names]

    def _group(self, robot: RobotModel, q: RobotConfiguration, request: PlanRequest) -> PlanningGroup:
        root = self.start.root
        group = limit_group(select(robot, self._moving, request.tip, q, root).starting_at(request.start), request)
        for joint in group.joints:
            if joint.kind in UNSERVED_KINDS:
                raise InvalidGroup(
                    f"`steps` are served for revolute, continuous, prismatic and planar joints; {joint.name!r} is"
                    f" {joint.kind.value}",
                    joint=joint.name,
                    path="$.steps",
                )
        return group

    def _joints(self, step: PlanStep) -> str | list[str] | None:
        return self._request.group if step.group is None else step.group

    def _tip(self, step: PlanStep) -> str:
        return step.tip or self._request.tip or self.start.robot.tip

    def _make_request(self, index: int, at: StepSituation) -> PlanRequest:
        step, request, robot = self._request.steps[index], self._limited_for(index), at.robot
        with _in_step(index):
            part = select(robot, self._joints(step), self._tip(step), at.q, at.root)
        moving = {*(joint.name for joint in part.joints), *mimic_laws(part)}
        permitted = [(one.name, other) for one in at.objects for other in self._touchable_obstacles(index, one, at)]
        return msgspec.structs.replace(
            request,
            goal=_goal(step, at, self._tip(step)),
            steps=[],
            group=step.group or request.group,
            tip=self._tip(step),
            start=configuration_to_wire(robot.joints, at.q),
            guide_planes=step.guide_planes,
            attached_objects=[one.attached for one in at.objects],
            allowed_collisions=[*request.allowed_collisions, *permitted],
            limits={name: limits for name, limits in request.limits.items() if name in moving},
            objective=step.objective or request.objective,
            execution=_narrow(request.execution, moving),
        )

    def _limited_for(self, index: int) -> PlanRequest:
        request, step = self._request, self._request.steps[index]
        return msgspec.structs.replace(
            request,
            cartesian_limits=request.cartesian_limits if step.cartesian_limits is None else step.cartesian_limits,
            max_velocity_scaling_factor=step.max_velocity_scaling_factor or request.max_velocity_scaling_factor,
            max_acceleration_scaling_factor=step.max_acceleration_scaling_factor
            or request.max_acceleration_scaling_factor,
        )

    def _touchable_obstacles(self, index: int, one: HeldObject, at: StepSituation) -> frozenset[str]:
        """Obstacles that a held object may touch while a step is planned: what it still stands on or is put down on.

        The certificate of the whole knows better when it may.
        """
        if not one.touch_objects:
            return frozenset()
        until = next((k for k in range(index, len(self)) if self.detached(k) == one.name), None)
        if until is not None and not any(self._carries(k, one, at) for k in range(index + 1, until + 1)):
            return frozenset(one.touch_objects)
        return one.near

    def _carries(self, index: int, one: HeldObject, at: StepSituation) -> bool:
        step = self._request.steps[index]
        if step.goal is None:
            return False
        model = at.robot.model
        frame = model.frames[at.robot.frame_id(one.attached.link)]
        supports = {model.names[joint] for joint in model.supports[frame.parentJoint] if joint}
        part = select(at.robot, self._joints(step), self._tip(step), at.q, at.root)
        moving = {*(joint.name for joint in part.joints), *mimic_laws(part)}
        return bool(supports & moving)

    def _make_planner(self, request: PlanRequest, line: CartesianLine | None) -> Callable[[Problem], Plan]:
        def plan_step(problem: Problem) -> Plan:
            began = working_time()
            if (refusal := refuse_ends(problem)) is not None:
                return refusal
            prepare_problem(request, problem, self._preparing)
            loaded = working_time() - began
            if line is not None:
                made = straight_plan(problem, line)
            else:
                derived, derivation = with_derived_planes(problem, request)
                attempts = ATTEMPTS[request.minimizer](problem.group)
                made = derivation.add_to(plan(derived, Planner(request.planner), attempts))
            return dataclasses.replace(made, seconds={**made.seconds, "load": loaded})

        return plan_step

    def _require_passable(self) -> None:
        """Refuse goals that can't be passed without a stop: the planner rounds motions of the same joints only."""
        for index, step in enumerate(self._request.steps):
            if step.stop:
                continue
            with _in_step(index):
                if index + 1 == len(self):
                    raise MalformedRequest("`stop: false` needs a step after it: the last one ends at rest")
                after = self._request.steps[index + 1]
                if after.goal is None:
                    raise MalformedRequest("`stop: false` needs a step after it that moves: that one has no `goal`")
                one, other = (self._find_moved_joints(step), self._find_moved_joints(after))
                if one != other:
                    raise MalformedRequest(
                        f"`stop: false` needs a step after it that moves the same joints: this one moves"
                        f" {', '.join(one)}, that one {', '.join(other)}",
                        joints=one,
                        next_joints=other,
                    )

    def _find_moved_joints(self, step: PlanStep) -> list[str]:
        return [
            joint.name
            for joint in select(
                self.start.robot, self._joints(step), self._tip(step), self.start.q, self.start.root
            ).joints
        ]

    def require_posed(self) -> None:
        """Refuse what is ill-posed in any step before one is planned, as if no goal moved the robot.

        As far as there is time; where it is up, the first step that is planned says so; raises GuidefieldError as
        `problem_of`, with the step's path.
        """
        at = self.start
        for index in range(len(self)):
            if self._deadline.expired():
                return
            self.motion(index, at, 0.0)
            at = self.after(index, at, at.q, math.inf)


def _require_served(request: PlanRequest) -> None:
    if request.leave_start_contact:
        raise MalformedRequest(
            "with `steps`, `leave_start_contact` is not served: leave it out", unserved="leave_start_contact"
        )
    if in_motion(request):
        raise MalformedRequest(
            "with `steps`, `start_velocities`, `start_accelerations` and `end_velocities` are not served: every step"
            " begins and ends at rest",
            unserved="start_velocities",
            path="$.start_velocities",
        )
    if request.guide_planes:
        raise MalformedRequest(
            "with `steps`, `guide_planes` are those of a step: give them there", path="$.guide_planes"
        )


def _narrow(execution: ExecutionOptions | None, moving: set[str]) -> ExecutionOptions | None:
    if execution is None or not isinstance(execution.tolerance, dict):
        return execution
    tolerance = {name: value for name, value in execution.tolerance.items() if name in moving}
    return msgspec.structs.replace(execution, tolerance=tolerance)


def _goal(step: PlanStep, at: StepSituation, tip: str) -> requests.Goal:
    goal = step.goal
    assert goal is not None, "the step moves"
    if not isinstance(goal, RelativeGoal):
        return goal
    here, by = at.frame(tip), se3(goal.position, goal.quaternion_xyzw)
    there = (
        here * by if goal.frame == "tip" else pin.SE3(by.rotation @ here.rotation, here.translation + by.translation)
    )
    return requests.PoseGoal(*wire_pose(there))


def _line(step: PlanStep, request: PlanRequest, problem: Problem) -> CartesianLine:
    assert isinstance(request.goal, requests.PoseGoal), "a straight way leads to a pose"
    group = problem.group
    begin = problem.kinematics.frame_placement(group.expand_from_local(problem.z_start), group.tip_id)
    end = se3(request.goal.position, request.goal.quaternion_xyzw)
    return CartesianLine(group.tip, begin, end, step.line_tolerance, step.turn_tolerance)


@contextmanager
def _in_step(index: int) -> Iterator[None]:
    try:
        yield
    except GuidefieldError as error:
        here, inner = f"$.steps[{index}]", str(error.details.get("path", ""))
        if inner.startswith("$.steps"):
            raise
        here += next((inner[1:] for field in STEP_FIELDS if inner.startswith(f"$.{field}")), "")
        details: dict[str, Any] = {**error.details, "path": here, "step": index}
        raise type(error)(f"`steps[{index}]`: {error.message}", **details) from None
