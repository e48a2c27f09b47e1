"""When something happens on a planned motion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

import guidefield
from guidefield.messages.replies import PlanReply
from guidefield.messages.requests import ForwardKinematics, PlanRequest, ReadRobot


def moments(request: PlanRequest, reply: PlanReply) -> list[tuple[str, float]]:
    """Start, where the tip crosses each guide plane, and the end: each with its time [s]."""
    assert reply.trajectory is not None
    about = guidefield.answer(ReadRobot(request.robot))
    rows = [_positions(reply.position_names, row) for row in reply.trajectory.positions]
    asked = ForwardKinematics(
        robot=request.robot, frames=[about.tip], configurations=rows, robot_placement=request.robot_placement
    )
    tip = np.array([placements[0].position for placements in guidefield.answer(asked).placements])
    times = reply.trajectory.times
    found = [("start", times[0])]
    for plane in reply.guide_planes[:-1]:
        corners = np.array(plane.vertices)
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        side = (tip - corners[0]) @ normal
        at = int(np.argmax(side * side[0] <= 0.0))
        found.append((plane.name, times[at]))
    return [*found, ("goal", times[-1])]


def _positions(names: Sequence[str], row: Sequence[float]) -> dict[str, float | list[float]]:
    """A row of a path as a request wants it: `ball1.qx`, `ball1.qy` .. belong to one joint."""
    found: dict[str, float | list[float]] = {}
    for name, value in zip(names, row, strict=True):
        joint, dot, _ = name.rpartition(".")
        if dot:
            found.setdefault(joint, []).append(value)
        else:
            found[name] = value
    return found
