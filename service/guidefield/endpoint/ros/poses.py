"""Numbers, vectors and poses of ROS messages, and back."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pinocchio as pin

from guidefield.endpoint.ros.refusals import Refused
from guidefield.geometry.placements import wire_pose
from guidefield.messages.values import LARGEST


def number(value: float, field: str, kind: type[Refused] = Refused) -> float:
    """A number, if it is finite and within what can be computed with; else raises Refused."""
    if not abs(value) <= LARGEST:
        raise kind(f"`{field}` must be a finite number within {LARGEST:g}, got {value}")
    return float(value)


def vector(message: Any, field: str) -> np.ndarray:
    """A geometry_msgs Point or Vector3, shape (3,); raises Refused if a number isn't finite."""
    return np.array([number(getattr(message, axis), f"{field}.{axis}") for axis in "xyz"])


def rotation(message: Any, field: str) -> np.ndarray:
    """The rotation matrix (3, 3) of a geometry_msgs Quaternion of any length.

    Of one that is all zero it is the identity, as in MoveIt; raises Refused if a number isn't finite.
    """
    x, y, z, w = (number(getattr(message, axis), f"{field}.{axis}") for axis in "xyzw")
    norm = math.hypot(x, y, z, w)
    if norm == 0.0:
        return np.eye(3)
    matrix: np.ndarray = pin.Quaternion(w / norm, x / norm, y / norm, z / norm).toRotationMatrix()
    return matrix


def placement(pose: Any, field: str) -> Any:
    """The pinocchio.SE3 of a geometry_msgs Pose; raises Refused if a number isn't finite."""
    return pin.SE3(rotation(pose.orientation, f"{field}.orientation"), vector(pose.position, f"{field}.position"))


def pose_message(there: Any) -> dict[str, Any]:
    """Return a geometry_msgs Pose of a pinocchio.SE3."""
    position, quaternion = wire_pose(there)
    return {
        "position": dict(zip("xyz", position, strict=True)),
        "orientation": dict(zip("xyzw", quaternion, strict=True)),
    }
