"""Goals of continuous joints that are so many turns away that they are hardly in radians."""

from __future__ import annotations

import math

from guidefield.messages import requests
from guidefield.messages.requests import PlanRequest
from guidefield.robot.model.model import JointKind, RobotModel

HARDLY_RADIANS = 4.0 * math.pi
"""A goal that is further from the start was probably given in degrees [rad]: no whole turn is ever needed."""


def many_turns_warnings(request: PlanRequest, robot: RobotModel) -> list[str]:
    """A warning for each continuous joint whose goal is further than `HARDLY_RADIANS` from its start.

    A joint with limits needs none: there such a goal is refused.
    """
    goal = request.goal
    if isinstance(goal, requests.JointsGoal):
        many = [goal.positions]
    elif isinstance(goal, requests.JointSetGoal):
        many = goal.positions
    else:
        return []
    warnings: dict[str, str] = {}
    for positions in many:
        for name, value in positions.items():
            joint, start = robot.joint(name), request.start.get(name, 0.0)
            if joint is None or joint.kind is not JointKind.CONTINUOUS or isinstance(value, list):
                continue
            if not isinstance(start, list) and (away := abs(value - start)) > HARDLY_RADIANS:
                turns = f"{value:g} is {away / (2.0 * math.pi):.1f} turns from the start"
                warnings[name] = f"the goal of joint {name!r} is hardly in radians: {turns}"
    return list(warnings.values())
