"""Refusals over ROS: MoveIt's error codes, and a sentence that names the field."""

from __future__ import annotations

from typing import Any

from guidefield.errors import Status

SOURCE = "guidefield"  # who speaks, in every error code


FRAME_TRANSFORM_FAILURE = -21  # the one of MoveIt's error codes that is used and is no `Status`


class Refused(Exception):
    """A request that isn't served."""

    code: int = Status.FAILURE

    def __init__(self, message: str, code: int | None = None) -> None:
        super().__init__(message)
        self.code = code or self.code
        self.message = message


class ObjectRefused(Refused):
    """An object or a shape isn't served."""

    code = Status.INVALID_OBJECT_NAME


class StateRefused(Refused):
    """A state isn't served."""

    code = Status.INVALID_ROBOT_STATE


class GoalRefused(Refused):
    """A goal or a constraint isn't served."""

    code = Status.INVALID_GOAL_CONSTRAINTS


class LinkRefused(Refused):
    """A link is unknown, or not the one that is served."""

    code = Status.INVALID_LINK_NAME


class FrameRefused(Refused):
    """A frame is unknown, or moves."""

    code = FRAME_TRANSFORM_FAILURE


def moveit_code(status: int) -> Status:
    """MoveIt's code for a status of ours: the same where MoveIt has it, else the nearest more general one."""
    if status in _SHARED:
        return Status(status)
    return Status.PLANNING_FAILED if status in _PLANNING else Status.FAILURE


_SHARED = {status for status in Status if status > Status.STUCK_IN_MINIMUM} - {Status.COMMUNICATION_FAILURE}
_PLANNING = {Status.STUCK_IN_MINIMUM, Status.GUIDE_PLANE_UNREACHABLE, Status.CLEARANCE_BELOW_MINIMUM}


def require_no_constraints(constraints: Any, where: str) -> None:
    """Refuse a moveit_msgs/Constraints with anything in it, where none are served.

    Raises:
        Refused: names the field.
    """
    for field in ("joint_constraints", "position_constraints", "orientation_constraints", "visibility_constraints"):
        if getattr(constraints, field):
            raise GoalRefused(f"`{where}.{field}` isn't served")
