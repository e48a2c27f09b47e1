"""Refusals of ROS messages, with MoveIt's error codes and a sentence that names the field; checked numbers, poses.

Codes are MoveIt's numbers (moveit_msgs/MoveItErrorCodes); `moveit_code` maps the statuses that it lacks.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pinocchio as pin

from guidefield.errors import Status
from guidefield.geometry.surfaces import wire_pose
from guidefield.messages.values import LARGEST

SOURCE = "guidefield"  # the source in every error code
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
    """Return MoveIt's code for a status of ours: the same if MoveIt has it, else the nearest more general one."""
    if status in _SHARED:
        return Status(status)
    return Status.PLANNING_FAILED if status in _PLANNING else Status.FAILURE


_SHARED = {status for status in Status if status > Status.STUCK_IN_MINIMUM} - {Status.COMMUNICATION_FAILURE}
_PLANNING = {Status.STUCK_IN_MINIMUM, Status.GUIDE_PLANE_UNREACHABLE, Status.CLEARANCE_BELOW_MINIMUM}


def require_no_constraints(constraints: Any, where: str) -> None:
    """Raise Refused, with the name of the field, if a moveit_msgs/Constraints has any constraint."""
    for field in ("joint_constraints", "position_constraints", "orientation_constraints", "visibility_constraints"):
        if getattr(constraints, field):
            raise GoalRefused(f"`{where}.{field}` isn't served")


def number(value: float, field: str, kind: type[Refused] = Refused) -> float:
    """Return a number if it is finite and at most `LARGEST`; else raise Refused."""
    if not abs(value) <= LARGEST:
        raise kind(f"`{field}` must be a finite number within {LARGEST:g}, got {value}")
    return float(value)


def vector(message: Any, field: str) -> np.ndarray:
    """Return a geometry_msgs Point or Vector3, shape (3,); raises Refused if a number isn't finite."""
    return np.array([number(getattr(message, axis), f"{field}.{axis}") for axis in "xyz"])


def rotation(message: Any, field: str) -> np.ndarray:
    """Return the rotation matrix (3, 3) of a geometry_msgs Quaternion of any length.

    If all its numbers are zero, it is the identity, as in MoveIt; raises Refused if a number isn't finite.
    """
    x, y, z, w = (number(getattr(message, axis), f"{field}.{axis}") for axis in "xyzw")
    norm = math.hypot(x, y, z, w)
    if norm == 0.0:
        return np.eye(3)
    matrix: np.ndarray = pin.Quaternion(w / norm, x / norm, y / norm, z / norm).toRotationMatrix()
    return matrix


def placement(pose: Any, field: str) -> Any:
    """Return the pinocchio.SE3 of a geometry_msgs Pose; raises Refused if a number isn't finite."""
    return pin.SE3(rotation(pose.orientation, f"{field}.orientation"), vector(pose.position, f"{field}.position"))


def pose_message(there: Any) -> dict[str, Any]:
    """Return a geometry_msgs Pose of a pinocchio.SE3."""
    position, quaternion = wire_pose(there)
    return {
        "position": dict(zip("xyz", position, strict=True)),
        "orientation": dict(zip("xyzw", quaternion, strict=True)),
    }
