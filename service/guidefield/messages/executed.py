"""Make the certify request that judges what a robot executed of a plan: its joint states against the plan's motion."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import msgspec

from guidefield.errors import MalformedRequest, UnknownObject
from guidefield.messages.certify_request import CertifyRequest, GivenTrajectory
from guidefield.messages.plan_reply import PlanReply
from guidefield.messages.requests import PlanRequest

SHARED_FIELDS = (
    "robot",
    "scene",
    "robot_placement",
    "start",
    "min_clearance",
    "attached_objects",
    "allowed_collisions",
    "path_constraints",
    "limits",
    "cartesian_limits",
    "max_velocity_scaling_factor",
    "max_acceleration_scaling_factor",
    "leave_start_contact",
)
"""Fields that plan and certify requests have both; the command line copies them to judge a stored run again."""


class JointStates(NamedTuple):
    """Where joints were, in the order of time.

    Attributes:
        joints: Their names.
        times: When [s].
        positions: A row for each time, in the order of the joints [rad or m].
    """

    joints: Sequence[str]
    times: Sequence[float]
    positions: Sequence[Sequence[float]]


def judgement_of(
    request: PlanRequest, reply: PlanReply, states: JointStates, begin: float = 0.0, allowed_time: float = 60.0
) -> CertifyRequest:
    """Make the request that judges what a robot executed of a plan, straight between its states; torques aren't judged.

    Args:
        states: Of all joints of the plan, in any order; other joints don't count.
        begin: When the motion began, on the clock of the states [s]; states before it don't count.
        allowed_time: For the judgement [s].

    Raises:
        UnknownObject: if the plan has no motion.
        MalformedRequest: if a joint of the plan has no state or two columns, a state isn't one finite value for each
            joint, two states are in the wrong order, there are none since the motion began, or the plan picks up or
            puts down.
    """
    planned = reply.trajectory
    if planned is None:
        raise UnknownObject(f"run {reply.run_id!r} has no motion: {reply.status.name}", run_id=reply.run_id)
    if any(step.attach is not None or step.detach is not None for step in request.steps):
        raise MalformedRequest("what is executed is judged against a plan that carries the same things all along")
    for joint in reply.position_names:
        if joint not in states.joints:
            raise MalformedRequest(
                f"the joint states have no joint {joint!r}, which the plan moves; they have {', '.join(states.joints)}",
                joint=joint,
                available=[*states.joints],
            )
        if states.joints.count(joint) > 1:
            raise MalformedRequest(f"the joint states have joint {joint!r} more than once", joint=joint)
    columns = [states.joints.index(joint) for joint in reply.position_names]
    if len(states.times) != len(states.positions):
        raise MalformedRequest(f"the joint states have {len(states.times)} times and {len(states.positions)} rows")
    times, positions = list[float](), list[list[float]]()
    for index, (time, row) in enumerate(zip(states.times, states.positions, strict=True)):
        _require_state(index, time, row, columns, states.joints)
        if index and time < states.times[index - 1]:
            raise MalformedRequest(
                f"the joint states are in the wrong order: state {index} is of {time:.9g} s, the one before of"
                f" {states.times[index - 1]:.9g} s",
                row=index,
            )
        if time >= begin and (not times or time - begin > times[-1]):  # several nodes may send states of one time
            times.append(time - begin)
            positions.append([row[column] for column in columns])
    if not times:
        last = f"the last one is of {states.times[-1]:.9g} s" if len(states.times) else "there are none"
        raise MalformedRequest(f"no joint state is of {begin:.9g} s or later: {last}")
    shared = {name: getattr(request, name) for name in SHARED_FIELDS if name != "leave_start_contact"}
    shared["limits"] = {name: msgspec.structs.replace(one, effort=None) for name, one in request.limits.items()}
    plan = GivenTrajectory(positions=planned.positions, times=planned.times, velocities=planned.velocities)
    try:
        executed = GivenTrajectory(positions=positions, times=times)
    except ValueError as error:
        raise MalformedRequest(f"the joint states, since the motion began, in the plan's columns: {error}") from None
    return CertifyRequest(
        **shared,
        tip=request.tip,
        position_names=reply.position_names,
        trajectory=executed,
        interpolation="linear",
        planned=plan,
        allowed_time=allowed_time,
        recording=request.recording,
    )


def _require_state(
    index: int, time: float, row: Sequence[float], columns: Sequence[int], joints: Sequence[str]
) -> None:
    if len(row) != len(joints):
        raise MalformedRequest(f"joint state {index} has {len(row)} values for {len(joints)} joints", row=index)
    if not math.isfinite(time):
        raise MalformedRequest(f"joint state {index} is of {time} s, which is no time", row=index)
    for column in columns:
        if not math.isfinite(row[column]):
            raise MalformedRequest(
                f"joint state {index}, of {time:.9g} s, has joint {joints[column]!r} at {row[column]}",
                row=index,
                joint=joints[column],
            )
