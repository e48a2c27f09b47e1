"""Read the parts of requests and streams that are about the planning group: start, limits, constraints, execution.

Plans, steps and certify requests share it, and streams what is of limits and start (stream/opening.py): what is refused
or clamped there is so in all of them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from guidefield.errors import InvalidConfiguration, MalformedRequest, at_path
from guidefield.messages import requests
from guidefield.messages.requests import Goal, MotionRequest, Positions, RelativeGoal
from guidefield.messages.streams import StreamOpen
from guidefield.messages.values import JointSetGoal, JointsGoal
from guidefield.planner.task.effort import EffortLimit, tree_of
from guidefield.planner.task.motion_limits import CartesianLimit, frame_limit, link_limit
from guidefield.planner.task.problem import ControllerModel, Interpolation
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.path_constraints import PathConstraint, build_constraint
from guidefield.robot.model.configuration import (
    LimitFault,
    clamp,
    configuration_from_wire,
    find_given_faults,
    limit_faults,
)
from guidefield.robot.model.joints import LocalRate, Mimic, RobotConfiguration
from guidefield.robot.model.model import RobotModel


def start_of(positions: Positions, robot: RobotModel) -> tuple[RobotConfiguration, list[str]]:
    """The start of the whole robot, shape (nq,), clamped where it is slightly beyond a limit; and warnings.

    Raises InvalidConfiguration as `configuration_from_wire`.
    """
    with at_path("$.start"):
        q = configuration_from_wire(robot, positions)
    warnings = [
        f"start {fault.joint} was {fault.excess:.2g} beyond its limit and was clamped"
        for fault in limit_faults(robot.joints, q)
        if fault.is_slight
    ]
    return (clamp_slight(robot, q) if warnings else q), warnings


def goal_positions(goal: Goal | RelativeGoal | None) -> list[Positions]:
    """Return the configurations of a goal, unchanged; none for a goal of another kind."""
    if isinstance(goal, JointSetGoal):
        return goal.positions
    return [goal.positions] if isinstance(goal, JointsGoal) else []


def warn_of_clamped_goals(goal: Goal | RelativeGoal | None, robot: RobotModel) -> list[str]:
    """Warn about each joint that a goal's configurations have slightly beyond its limit (`LimitFault.is_slight`)."""
    worst: dict[str, LimitFault] = {}
    for positions in goal_positions(goal):
        for fault in find_given_faults(robot.joints, positions):
            if fault.is_slight and (fault.joint not in worst or fault.excess > worst[fault.joint].excess):
                worst[fault.joint] = fault
    return [f"goal {name} was {fault.excess:.2g} beyond its limit and was clamped" for name, fault in worst.items()]


def clamp_slight(robot: RobotModel, q: RobotConfiguration) -> RobotConfiguration:
    """A configuration (nq,) with values beyond a limit by at most `CLAMP_TOLERANCE` brought back to it."""
    slight = [j for f in limit_faults(robot.joints, q) if f.is_slight and (j := robot.joint(f.joint))]
    return clamp(slight, q)


def limit_group(group: PlanningGroup, request: MotionRequest | StreamOpen) -> PlanningGroup:
    """The group with the limits of a request, and its scaling factors.

    Raises InvalidConfiguration if a joint is named that neither is planned for nor follows one that is.
    """
    names, mimics = [joint.name for joint in group.joints], mimic_laws(group)
    for name in request.limits:
        if name not in names and name not in mimics:
            raise InvalidConfiguration(
                f"`limits` names joint {name!r}, which is not planned for; planned are {', '.join(names)}",
                joint=name,
                available=names,
                path=f"$.limits.{name}",
            )
    return group.with_limits(
        {name: limits.velocity for name, limits in request.limits.items() if limits.velocity is not None},
        {name: limits.acceleration for name, limits in request.limits.items() if limits.acceleration is not None},
        request.max_velocity_scaling_factor,
        request.max_acceleration_scaling_factor,
    )


def mimic_laws(group: PlanningGroup) -> dict[str, Mimic]:
    """The law of each mimic joint whose source joint is planned for."""
    planned = {joint.name for joint in group.joints}
    laws = {joint.name: joint.mimic for joint in group.robot.joints if joint.mimic is not None}
    return {name: law for name, law in laws.items() if law.source in planned}


def rates_of(rates: Mapping[str, float], field: str, group: PlanningGroup) -> LocalRate | None:
    """Return the rates of all coordinates, shape (nv,), 0 where the request gives none; None if all are 0.

    Raises InvalidConfiguration if a joint is named that doesn't move, or has several coordinates.
    """
    joints = {joint.name: joint for joint in group.joints}
    for name in rates:
        details = {"joint": name, "path": f"$.{field}.{name}"}
        if name not in joints:
            raise InvalidConfiguration(
                f"`{field}` names joint {name!r}, which is not planned for; planned are {', '.join(joints)}",
                available=list(joints),
                **details,
            )
        if joints[name].nv != 1:
            raise InvalidConfiguration(
                f"`{field}` is served for joints of one coordinate; {name!r} is {joints[name].kind.value}", **details
            )
    if not any(rates.values()):
        return None
    return np.concatenate([np.full(joint.nv, rates.get(joint.name, 0.0)) for joint in group.joints])


def jerk_limits(group: PlanningGroup, request: MotionRequest | StreamOpen) -> LocalRate | None:
    """Return the jerk limits of all coordinates, shape (nv,), infinite where there is none; None without any."""
    requested = {name: limits.jerk for name, limits in request.limits.items() if limits.jerk is not None}
    if not requested:
        return None
    for name, law in mimic_laws(group).items():
        if name in requested and law.multiplier != 0.0:
            requested[law.source] = min(requested.get(law.source, np.inf), requested[name] / abs(law.multiplier))
    return np.concatenate([np.full(joint.nv, requested.get(joint.name, np.inf)) for joint in group.joints])


def execution_of(request: MotionRequest, group: PlanningGroup) -> ControllerModel | None:
    """Build the model of the controller that executes a group's motion; None if the request has no `execution`.

    Raises:
        MalformedRequest: if what is drawn can't keep a limit.
        InvalidConfiguration: if a joint has several coordinates, or a tolerance names one that the group doesn't move.
    """
    execution = request.execution
    if execution is None:
        return None
    if request.cartesian_limits and execution.interpolation == Interpolation.ZERO_ORDER_HOLD.value:
        raise MalformedRequest(
            "with `execution.interpolation` 'zero_order_hold' `cartesian_limits` are not served: steps have no speed",
            unserved="cartesian_limits",
        )
    interpolation = execution.interpolation
    jumps = interpolation not in ("cubic", "quintic")
    if jumps and any(one.acceleration is not None for one in request.cartesian_limits):
        raise MalformedRequest(
            f"with `execution.interpolation` {interpolation!r} limits of acceleration in space are not served:"
            " velocities jump, which takes any acceleration",
            unserved="cartesian_limits",
            path="$.cartesian_limits",
        )
    if jumps and bounds_efforts(request):
        raise MalformedRequest(
            f"with `execution.interpolation` {interpolation!r} limits of effort are not served: velocities jump,"
            " which takes any torque",
            unserved="limits",
            path="$.limits",
        )
    if not group.is_euclidean:
        several = [joint.name for joint in group.joints if joint.nv > 1]
        raise InvalidConfiguration(
            f"`execution` is served for joints of one coordinate; {', '.join(several)} has several", joints=several
        )
    tolerance = np.zeros(group.nv)
    if isinstance(execution.tolerance, dict):
        places = {joint.name: joint.idx_v for joint in group.joints}
        for name, value in execution.tolerance.items():
            if name not in places:
                raise InvalidConfiguration(
                    f"`execution.tolerance` names joint {name!r}, which the group doesn't move; it moves"
                    f" {', '.join(places)}",
                    joint=name,
                    available=list(places),
                    path=f"$.execution.tolerance.{name}",
                )
            tolerance[places[name]] = value
    else:
        tolerance[:] = execution.tolerance
    return ControllerModel(Interpolation(interpolation), execution.rate, tolerance)


def constraints_of(request: MotionRequest, group: PlanningGroup) -> tuple[PathConstraint, ...]:
    """Build the path constraints of a request.

    Raises UnknownFrame if the robot has no such frame; MalformedRequest if a direction is zero, or a joint of several
    coordinates is planned for.
    """
    if request.path_constraints and not group.is_euclidean:
        several = [joint.name for joint in group.joints if joint.nv > 1]
        raise MalformedRequest(
            "path constraints are served for joints of one coordinate only, and planned for is"
            f" {', '.join(several)}; a `group` may leave it out",
            joints=several,
        )
    constraints = []
    for index, one in enumerate(request.path_constraints):
        with at_path(f"$.path_constraints[{index}].frame"):
            group.robot.frame_id(one.frame)
        constraints.append(build_constraint(one, f"path_constraints[{index}]"))
    return tuple(constraints)


def effort_limit_of(request: MotionRequest, group: PlanningGroup) -> EffortLimit | None:
    """Build the torque limits of a request; None if it has none.

    Raises MalformedRequest if the robot has no dynamics, or a joint is named that follows another one.
    """
    requested = {name: limits.effort for name, limits in request.limits.items() if limits.effort is not None}
    if not requested:
        return None
    tree, laws = tree_of(group), mimic_laws(group)
    for name in requested:
        if name in laws:
            raise MalformedRequest(
                f"`limits.{name}.effort` can't be kept: {name!r} follows {laws[name].source!r}, which is driven",
                joint=name,
                path=f"$.limits.{name}.effort",
            )
        if isinstance(tree, str):
            raise MalformedRequest(
                f"`limits.{name}.effort` can't be kept: {tree}", joint=name, path=f"$.limits.{name}.effort"
            )
    assert not isinstance(tree, str), "there is dynamics"
    limits = [np.full(joint.nv, requested.get(joint.name, np.inf)) for joint in group.joints]
    return EffortLimit(tree, np.concatenate(limits), tuple(group.velocity_names))


def bounds_efforts(request: MotionRequest | StreamOpen) -> bool:
    """Return whether a request limits the effort of a joint."""
    return any(limits.effort is not None for limits in request.limits.values())


def warn_of_missing_masses(request: MotionRequest) -> list[str]:
    """Warn about each held object without a mass, where efforts are limited."""
    if not bounds_efforts(request):
        return []
    names = [one.obstacle.name for one in request.attached_objects if one.mass is None]
    return [f"{name!r}, which is held, has no `mass`: it counts as massless in torques" for name in names]


def cartesian_limits_of(request: MotionRequest | StreamOpen, group: PlanningGroup) -> tuple[CartesianLimit, ...]:
    """Build the limits of speed in space of a request.

    Raises UnknownFrame if the robot has no such frame or link; MalformedRequest if a link has no geometry, or a ball or
    floating joint carries it.
    """
    return tuple(_build_cartesian_limit(one, index, group) for index, one in enumerate(request.cartesian_limits))


def _build_cartesian_limit(one: requests.CartesianLimit, index: int, group: PlanningGroup) -> CartesianLimit:
    acceleration = math.inf if one.acceleration is None else one.acceleration
    with at_path(f"$.cartesian_limits[{index}]"):
        if one.frame is not None:
            return frame_limit(group, one.frame, one.speed, acceleration)
        assert one.link is not None, "there is one of both"
        return link_limit(group, one.link, one.speed, acceleration)
