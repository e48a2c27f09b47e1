"""The robot that is offered over ROS: which joints and links a message may name, and where frames are."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import pinocchio as pin

from guidefield.endpoint.ros.refusals import LinkRefused, MoveItCode, Refused
from guidefield.errors import RobotInvalid
from guidefield.robot.model.configuration import configuration_from_wire, configuration_to_wire
from guidefield.robot.model.model import Joint, RobotModel

WORLD = "world"
"""The frame of obstacles, where the robot has no link of that name: that of its root."""


class KnownRobot:
    """A robot as messages of ROS name it.

    Raises:
        RobotInvalid: if a joint of it has several coordinates, which these messages have no place for.
    """

    def __init__(self, name: str, model: RobotModel) -> None:
        several = [joint.name for joint in model.joints if joint.nv > 1]
        if several:
            raise RobotInvalid(f"over ROS robots with joints of one coordinate are served; {name!r} has {several[0]!r}")
        self.name = name
        self.model = model
        self.joints: dict[str, Joint] = {joint.name: joint for joint in model.joints if joint.mimic is None}
        self.followers = {joint.name: joint for joint in model.joints if joint.mimic is not None}
        self.links = tuple(model.links)
        self.root = self.links[0]
        rest = configuration_to_wire(model.joints, model.rest)
        self.rest = {joint: float(rest[joint]) for joint in self.joints}  # type: ignore[arg-type]

    def group(self, name: str) -> list[str]:
        """The joints of a group; raises Refused if there is none of that name."""
        if name not in self.model.groups:
            groups = ", ".join(self.model.groups) or "no group"
            raise Refused(f"`group_name` {name[:64]!r} is unknown; there is {groups}", MoveItCode.INVALID_GROUP_NAME)
        return list(self.model.groups[name])

    def require_link(self, name: str, field: str) -> str:
        """The name itself, if it is a link's; else raises Refused."""
        if name not in self.links:
            raise LinkRefused(f"`{field}` {name[:64]!r} is no link of {self.name}: {', '.join(self.links)}")
        return name

    def is_root(self, frame: str) -> bool:
        """Whether a frame is the world's: the root link, nothing, or `WORLD`."""
        return frame in ("", self.root) or (frame == WORLD and WORLD not in self.links)

    def moves(self, link: str, joints: Iterable[str]) -> bool:
        """Whether a link moves when some joints do, and those that follow them."""
        driven = set(joints)
        driven |= {name for name, one in self.followers.items() if one.mimic is not None and one.mimic.driver in driven}
        model = self.model.model
        above = list(model.supports[model.frames[self.model.frame_id(link)].parentJoint])
        return any(model.names[joint] in driven for joint in above if joint)

    def placements(self, positions: Mapping[str, float], links: Iterable[str]) -> list[Any]:
        """Where links are in the world, pinocchio.SE3 each, at joint values by name [rad or m]."""
        model = self.model.model
        data = model.createData()
        pin.forwardKinematics(model, data, configuration_from_wire(self.model, dict(positions)))
        return [pin.SE3(pin.updateFramePlacement(model, data, self.model.frame_id(link))) for link in links]

    def limits(self, joint: str) -> tuple[float, float]:
        """The least and the largest value of a joint [rad or m]; infinite where it turns on and on."""
        one = self.joints[joint]
        lower, upper = float(one.lower[0]), float(one.upper[0])
        return (lower, upper) if math.isfinite(lower) and math.isfinite(upper) else (-math.inf, math.inf)
