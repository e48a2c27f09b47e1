"""Motions of replies, looked at with nothing of ours but the robot's model: Hermite's formula, Pinocchio and Coal."""

from typing import Any

import coal
import numpy as np
import pinocchio as pin

from guidefield.messages.replies import PlanReply
from tests.robots import robot


def states(reply: PlanReply, times: np.ndarray) -> np.ndarray:
    """Positions (n, k) of the reply's Hermite curve at times, by its own formula."""
    t, p, v = (np.array(getattr(reply.trajectory, name)) for name in ("times", "positions", "velocities"))
    i = np.clip(np.searchsorted(t, times, side="right") - 1, 0, len(t) - 2)
    h = (t[i + 1] - t[i])[:, None]
    s = (times - t[i])[:, None] / h
    return (
        (1 + 2 * s) * (1 - s) ** 2 * p[i]
        + s * (1 - s) ** 2 * h * v[i]
        + s**2 * (3 - 2 * s) * p[i + 1]
        - s**2 * (1 - s) * h * v[i + 1]
    )


class Bare:
    """A robot that knows nothing of what it holds, at rows of named positions."""

    def __init__(self, names: list[str], name: str = "panda") -> None:
        self.robot, self.names = robot(name), names
        self.data = self.robot.model.createData()
        self.scratch = pin.GeometryData(self.robot.geometry)

    def stand(self, row: np.ndarray) -> None:
        q = np.array(self.robot.rest, float)
        for name, value in zip(self.names, row, strict=True):
            q[self.robot.joint(name).idx_q] = value
        for joint in self.robot.joints:
            if joint.mimic is not None:
                q[joint.idx_q] = joint.mimic.multiplier * q[self.robot.joint(joint.mimic.source).idx_q]
                q[joint.idx_q] += joint.mimic.offset
        pin.framesForwardKinematics(self.robot.model, self.data, q)
        pin.updateGeometryPlacements(self.robot.model, self.data, self.robot.geometry, self.scratch)

    def frame(self, name: str) -> pin.SE3:
        return self.data.oMf[self.robot.frame_id(name)].copy()

    def bodies(self) -> list[tuple[str, Any, Any]]:
        """Link, shape and placement of all that moves."""
        shapes = self.robot.geometry.geometryObjects
        return [
            (self.robot.link_of_geometry(i), shape.geometry, self.scratch.oMg[i])
            for i, shape in enumerate(shapes)
            if shape.parentJoint
        ]


def frames_along(reply: PlanReply, frame: str, times: np.ndarray, name: str = "panda") -> list[pin.SE3]:
    """A frame's placements at times of the reply's motion."""
    bare, found = Bare(reply.position_names, name), []
    for row in states(reply, times):
        bare.stand(row)
        found.append(bare.frame(frame))
    return found


def distance(one: Any, at: Any, other: Any, there: Any) -> float:
    first, second = (coal.Transform3s(placed.rotation, placed.translation) for placed in (at, there))
    result = coal.DistanceResult()
    return float(coal.distance(one, first, other, second, coal.DistanceRequest(), result))
