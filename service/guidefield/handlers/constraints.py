"""The path constraints of a request."""

from __future__ import annotations

import numpy as np

from guidefield.errors import MalformedRequest, at_path
from guidefield.messages import requests
from guidefield.messages.requests import MotionRequest
from guidefield.robot.group import path_constraints
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.path_constraints import Cone, PathConstraint


def constraints_of(request: MotionRequest, group: PlanningGroup) -> tuple[PathConstraint, ...]:
    """What frames have to keep all along the motion.

    Raises:
        UnknownFrame: if the robot has no such frame.
        MalformedRequest: if a direction is zero, or a joint of several coordinates is planned for.
    """
    if request.path_constraints and not group.is_euclidean:
        several = [joint.name for joint in group.joints if joint.nv > 1]
        raise MalformedRequest(
            "path constraints are served for joints of one coordinate only, and planned for is"
            f" {', '.join(several)}; a `group` may leave it out",
            joints=several,
        )
    return tuple(_built(one, index, group) for index, one in enumerate(request.path_constraints))


def _built(one: requests.PathConstraint, index: int, group: PlanningGroup) -> PathConstraint:
    with at_path(f"$.path_constraints[{index}].frame"):
        group.robot.frame_id(one.frame)
    where = f"`path_constraints[{index}]"
    if isinstance(one, requests.OrientationCone):
        axis, target = _unit(one.axis, f"{where}.axis`"), _unit(one.target_axis, f"{where}.target_axis`")
        return Cone(one.frame, axis, target, one.half_angle)
    point = np.array(one.point)
    if isinstance(one, requests.PlaneConstraint):
        return path_constraints.plane(one.frame, point, _unit(one.normal, f"{where}.normal`"), one.tolerance)
    return path_constraints.line(one.frame, point, _unit(one.direction, f"{where}.direction`"), one.tolerance)


def _unit(vector: tuple[float, float, float], where: str) -> np.ndarray:
    length = float(np.linalg.norm(vector))
    if not (np.isfinite(length) and length > 1e-9):
        raise MalformedRequest(f"{where} must be a finite direction that isn't zero, got {list(vector)}")
    unit: np.ndarray = np.array(vector) / length
    return unit
