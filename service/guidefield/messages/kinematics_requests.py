"""What a client may ask at configurations, poses and points, one or a batch of them in one request."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import chain
from typing import Annotated, Literal

import msgspec

from guidefield.messages.conditions import AllowedCollisions, AttachedObjects
from guidefield.messages.goals import Positions, Tolerance3, require_finite_configurations
from guidefield.messages.references import RobotReference, SceneReference, settle_scene
from guidefield.messages.triples import TOGETHER
from guidefield.messages.values import (
    LARGEST,
    AllowedTime,
    Look,
    Message,
    Name,
    Placement,
    QuaternionXYZW,
    RunId,
    Vector3,
    never,
    require_finite,
    require_unit_quaternion,
)

DEFAULT_TIME = 60.0
"""How long a request may take that doesn't say it [s]."""

MOST_CONFIGURATIONS = 100_000
"""Configurations that a request may ask about."""
MOST_POSES = 10_000
"""Poses that one may ask to be reached."""
MOST_STARTS = 10_000
"""Configurations from which they may be looked for."""
MOST_POINTS = 1_000_000
"""Points that one may ask about."""


class ForwardKinematics(Message, tag_field="type", tag="forward_kinematics"):
    """Placements of frames at configurations.

    Attributes:
        robot: The robot.
        frames: Their names.
        configurations: Joints left out are at rest as the robot has it.
        schema: Version of this message.
        robot_placement: Of the robot's root in the world.
        request_id: A name by which it can be cancelled; null: none.
        allowed_time: From the request's arrival, queue and loading included [s].
    """

    robot: RobotReference
    frames: Annotated[list[Name], msgspec.Meta(min_length=1, max_length=1_000)]
    configurations: Annotated[list[Positions], msgspec.Meta(max_length=MOST_CONFIGURATIONS)]
    schema: Literal[1] = 1
    robot_placement: Placement = Placement()
    request_id: RunId | None = None
    allowed_time: AllowedTime = DEFAULT_TIME

    def __post_init__(self) -> None:
        require_finite_configurations("configurations", self.configurations)


class TargetPose(Message):
    """A pose for inverse kinematics; the fields are those of `PoseGoal`, 0 is as near as can be computed."""

    position: Vector3
    quaternion_xyzw: QuaternionXYZW
    position_tolerance: Tolerance3 = (0.0, 0.0, 0.0)
    orientation_tolerance: Tolerance3 = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        require_finite("position", self.position)
        require_unit_quaternion("quaternion_xyzw", self.quaternion_xyzw)


class InverseKinematics(Message, tag_field="type", tag="inverse_kinematics"):
    """Distinct configurations that bring the tip to each pose.

    Attributes:
        robot: The robot.
        poses: The poses.
        schema: Version of this message.
        robot_placement: Of the robot's root in the world.
        tip: Name of the frame that is brought there; null: the robot's own.
        group: Joints that may move, as in `PlanRequest`.
        scene: What may be in the way.
        collision_free: Whether only configurations that touch nothing count.
        attached_objects: What links hold; with `collision_free` it must touch nothing either.
        allowed_collisions: Pairs of links and obstacles that may touch.
        start_configurations: Where to start from, before random ones; joints outside the group are as in the first.
        solutions: How many to look for at each pose.
        seed: Of the random starts.
        request_id: A name by which it can be cancelled; null: none.
        allowed_time: From the request's arrival, queue and loading included [s].
    """

    robot: RobotReference
    poses: Annotated[list[TargetPose], msgspec.Meta(max_length=MOST_POSES)]
    schema: Literal[1] = 1
    robot_placement: Placement = Placement()
    tip: Name | None = None
    group: str | list[Name] | None = None
    scene: SceneReference | None = None
    collision_free: bool = False
    attached_objects: AttachedObjects = []
    allowed_collisions: AllowedCollisions = []
    start_configurations: Annotated[list[Positions], msgspec.Meta(max_length=MOST_STARTS)] = []
    solutions: Annotated[int, msgspec.Meta(ge=1, le=1_000)] = 8
    seed: Annotated[int, msgspec.Meta(ge=0, le=2**53)] = 0
    request_id: RunId | None = None
    allowed_time: AllowedTime = DEFAULT_TIME

    def __post_init__(self) -> None:
        settle_scene(self)
        require_finite_configurations("start_configurations", self.start_configurations)


class Clearance(Message, tag_field="type", tag="clearance"):
    """Distance of the robot's moving links to the obstacles, and to themselves, at configurations.

    Attributes:
        robot: The robot.
        scene: The obstacles.
        configurations: Joints left out are at rest as the robot has it.
        schema: Version of this message.
        robot_placement: Of the robot's root in the world.
        attached_objects: What links hold; they are measured as links.
        allowed_collisions: Pairs of links and obstacles that may touch, and aren't measured.
        contacts: Whether the reply tells which pairs touch.
        request_id: A name by which it can be cancelled; null: none.
        allowed_time: From the request's arrival, queue and loading included [s].
    """

    robot: RobotReference
    scene: SceneReference
    configurations: Annotated[list[Positions], msgspec.Meta(max_length=MOST_CONFIGURATIONS)]
    schema: Literal[1] = 1
    robot_placement: Placement = Placement()
    attached_objects: AttachedObjects = []
    allowed_collisions: AllowedCollisions = []
    contacts: bool = False
    request_id: RunId | None = None
    allowed_time: AllowedTime = DEFAULT_TIME

    def __post_init__(self) -> None:
        settle_scene(self)
        require_finite_configurations("configurations", self.configurations)


class Potential(Message, tag_field="type", tag="potential"):
    """The field of a scene at points (a unit point charge each), or on a robot at configurations.

    Attributes:
        scene: What is charged.
        schema: Version of this message.
        points: Where [m, world].
        robot: The robot, where no points are given.
        robot_placement: Of its root in the world.
        configurations: Joints left out are at rest as the robot has it.
        request_id: A name by which it can be cancelled; null: none.
        allowed_time: From the request's arrival, queue and loading included [s].
    """

    scene: SceneReference
    schema: Literal[1] = 1
    points: Annotated[list[Vector3], msgspec.Meta(max_length=MOST_POINTS)] | None = None
    robot: RobotReference | None = None
    robot_placement: Placement = Placement()
    configurations: Annotated[list[Positions], msgspec.Meta(max_length=MOST_CONFIGURATIONS)] | None = None
    request_id: RunId | None = None
    allowed_time: AllowedTime = DEFAULT_TIME

    def __post_init__(self) -> None:
        settle_scene(self)
        by_points = self.points is not None
        by_robot = self.robot is not None and self.configurations is not None
        if by_points == by_robot or (self.robot is None) != (self.configurations is None):
            raise ValueError("give either `points`, or `robot` with `configurations`")
        require_finite_points("points", self.points or ())
        require_finite_configurations("configurations", self.configurations or [])


KinematicsRequest = ForwardKinematics | InverseKinematics | Clearance | Potential


def require_finite_points(field: str, points: Sequence[Vector3], look: Look = never) -> None:
    """Raise ValueError if a number is NaN, infinite or too large; `look` is called again and again meanwhile."""
    for begin in range(0, len(points), TOGETHER):
        look()
        some = points[begin : begin + TOGETHER]
        if not math.hypot(*chain.from_iterable(some)) <= LARGEST:  # the norm of all is more than that of each
            for index, point in enumerate(some, begin):
                require_finite(f"{field}[{index}]", point)
