"""Refusals over ROS: MoveIt's error codes, and a sentence that names the field."""

from __future__ import annotations

import enum
from typing import Any

from guidefield.errors import Status

SOURCE = "guidefield"  # who speaks, in every error code


class MoveItCode(enum.IntEnum):
    """Values of moveit_msgs/MoveItErrorCodes that are used."""

    SUCCESS = 1
    PLANNING_FAILED = -1
    INVALID_MOTION_PLAN = -2
    TIMED_OUT = -6
    PREEMPTED = -7
    START_STATE_IN_COLLISION = -10
    START_STATE_VIOLATES_PATH_CONSTRAINTS = -11
    GOAL_IN_COLLISION = -12
    GOAL_VIOLATES_PATH_CONSTRAINTS = -13
    GOAL_CONSTRAINTS_VIOLATED = -14
    INVALID_GROUP_NAME = -15
    INVALID_GOAL_CONSTRAINTS = -16
    INVALID_ROBOT_STATE = -17
    INVALID_LINK_NAME = -18
    INVALID_OBJECT_NAME = -19
    FRAME_TRANSFORM_FAILURE = -21
    START_STATE_INVALID = -26
    GOAL_STATE_INVALID = -27
    CRASH = -29
    NO_IK_SOLUTION = -31
    FAILURE = 99999


class Refused(Exception):
    """A request that isn't served."""

    code = MoveItCode.FAILURE

    def __init__(self, message: str, code: MoveItCode | None = None) -> None:
        super().__init__(message)
        self.code = code or self.code
        self.message = message


class ObjectRefused(Refused):
    """An object or a shape isn't served."""

    code = MoveItCode.INVALID_OBJECT_NAME


class StateRefused(Refused):
    """A state isn't served."""

    code = MoveItCode.INVALID_ROBOT_STATE


class GoalRefused(Refused):
    """A goal or a constraint isn't served."""

    code = MoveItCode.INVALID_GOAL_CONSTRAINTS


class LinkRefused(Refused):
    """A link is unknown, or not the one that is served."""

    code = MoveItCode.INVALID_LINK_NAME


class FrameRefused(Refused):
    """A frame is unknown, or moves."""

    code = MoveItCode.FRAME_TRANSFORM_FAILURE


def moveit_code(status: int) -> MoveItCode:
    """MoveIt's code for a status of ours: the same where MoveIt has it, else the nearest more general one."""
    if status in _VALUES:
        return MoveItCode(status)
    return MoveItCode.PLANNING_FAILED if status in _PLANNING else MoveItCode.FAILURE


_VALUES = {code.value for code in MoveItCode}
_PLANNING = {Status.STUCK_IN_MINIMUM, Status.GUIDE_PLANE_UNREACHABLE, Status.CLEARANCE_BELOW_MINIMUM}


def require_no_constraints(constraints: Any, where: str) -> None:
    """Refuse a moveit_msgs/Constraints with anything in it, where none are served.

    Raises:
        Refused: names the field.
    """
    for field in ("joint_constraints", "position_constraints", "orientation_constraints", "visibility_constraints"):
        if getattr(constraints, field):
            raise GoalRefused(f"`{where}.{field}` isn't served")
