"""Goals of a stream as configurations: those that are given, or that bring the tip to a pose."""

from __future__ import annotations

from typing import cast

import numpy as np

from guidefield.errors import InvalidGoal, at_path
from guidefield.messages.goals import JointSetGoal, JointsGoal, PoseGoal
from guidefield.messages.streams import StreamGoal
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.ik.inverse_kinematics import solve
from guidefield.robot.ik.pose_target import PoseTarget
from guidefield.robot.model.configuration import LIMIT_TOLERANCE, configuration_from_wire, limit_faults
from guidefield.robot.model.spaces import ChartPoint, ChartPoints
from guidefield.stream.settings import STREAM
from guidefield.stream.ways import Room


def goals_of(
    goal: StreamGoal, group: PlanningGroup, room: Room, near: ChartPoint, rng: np.random.Generator
) -> ChartPoints:
    """The configurations that a goal means, free of what rests and of themselves, shape (k, nv).

    Args:
        near: Where the robot is, shape (nv,): of whole turns the nearest are taken.

    Raises:
        InvalidGoal: if it names joints that don't move, or no configuration of it is within limits and free.
    """
    if isinstance(goal, PoseGoal):
        found = solve(group, PoseTarget.from_wire(goal), [near], STREAM.goals, rng=rng, accept=room.resting_free)
        if not found.solutions:
            raise InvalidGoal(f"the goal's pose can't be reached: {found.reason}", **found.details)
        return np.array(found.solutions)
    given = goal.positions if isinstance(goal, JointSetGoal) else [goal.positions]
    zs = np.array([_configuration(goal, index, group, near) for index in range(len(given))])
    within = ((zs >= group.lower - LIMIT_TOLERANCE) & (zs <= group.upper + LIMIT_TOLERANCE)).all(axis=1)
    if not within.any():
        q = group.from_chart(zs[0])
        fault = limit_faults(group.joints, q)[0]
        raise InvalidGoal(
            f"the goal has {fault.joint} at {fault.value:.6g}, its limits are {fault.lower:.6g} and {fault.upper:.6g}",
            joint=fault.joint,
            value=fault.value,
        )
    zs = np.clip(zs[within], group.lower, group.upper)
    free = room.resting_free(zs)
    if not free.any():
        raise InvalidGoal("the goal touches the scene or the robot itself, or is closer to the scene than 4 mm")
    return cast(ChartPoints, zs[free])


def _configuration(goal: JointsGoal | JointSetGoal, index: int, group: PlanningGroup, near: ChartPoint) -> ChartPoint:
    positions = goal.positions[index] if isinstance(goal, JointSetGoal) else goal.positions
    planned = {joint.name for joint in group.joints}
    for name in positions:
        if group.robot.joint(name) is not None and name not in planned:
            raise InvalidGoal(
                f"the goal gives joint {name!r}, which doesn't move; those that do are {', '.join(sorted(planned))}",
                joint=name,
                available=sorted(planned),
            )
    with at_path(f"$.goal.positions[{index}]" if isinstance(goal, JointSetGoal) else "$.goal.positions"):
        q = configuration_from_wire(group.robot, positions, base=group.q_reference, error=InvalidGoal)
    return group.unwrapped(group.chart(group.part_of(q)), near)
