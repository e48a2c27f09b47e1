"""What a client may ask: the plan request and the tagged requests of the other keys."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import msgspec

from guidefield.messages.scene import GuidePlane, Obstacle, Scene
from guidefield.messages.store_requests import (
    DeleteRobot as DeleteRobot,
    DeleteRun as DeleteRun,
    DeleteScene as DeleteScene,
    ReadInfo as ReadInfo,
    ReadRobot as ReadRobot,
    ReadRobots as ReadRobots,
    ReadRun as ReadRun,
    ReadRuns as ReadRuns,
    ReadScene as ReadScene,
    ReadScenes as ReadScenes,
    RobotFiles as RobotFiles,
    StoreRequest,
    StoreRobot as StoreRobot,
    StoreScene as StoreScene,
)
from guidefield.messages.values import (
    Message,
    Name,
    NonNegative,
    Placement,
    Positive,
    QuaternionXYZW,
    RootJoint,
    RunId,
    UrdfCharacters,
    Vector3,
    require_finite,
    require_unit_quaternion,
)

JointValue = float | list[float]
Positions = dict[str, JointValue]
"""A configuration: joint name to value; see wire.md "Configurations" for the value of each kind of joint."""

Tolerance3 = tuple[NonNegative | None, NonNegative | None, NonNegative | None]


def require_finite_positions(field: str, positions: Positions) -> None:
    """Raise ValueError if a joint value is NaN or infinite."""
    for joint, value in positions.items():
        require_finite(f"{field}.{joint}", value if isinstance(value, list) else (value,))


class UrdfText(Message, tag_field="type", tag="urdf"):
    """A robot sent as text. Meshes must come from packages that the service allows."""

    text: UrdfCharacters
    srdf: UrdfCharacters | None = None
    root_joint: RootJoint = "fixed"


class UrdfFile(Message, tag_field="type", tag="urdf_file"):
    """A robot in local files: in Python and on the command line only, refused from the wire."""

    path: str
    srdf_path: str | None = None
    package_dirs: list[str] = []
    root_joint: RootJoint = "fixed"


RobotReference = str | UrdfText | UrdfFile
SceneReference = str | Scene


class JointsGoal(Message, tag_field="type", tag="joints"):
    """Reach one configuration."""

    positions: Positions

    def __post_init__(self) -> None:
        require_finite_positions("positions", self.positions)


class JointSetGoal(Message, tag_field="type", tag="joint_set"):
    """Reach any one of several configurations."""

    positions: Annotated[list[Positions], msgspec.Meta(min_length=1, max_length=10_000)]

    def __post_init__(self) -> None:
        for index, positions in enumerate(self.positions):
            require_finite_positions(f"positions[{index}]", positions)


class PoseGoal(Message, tag_field="type", tag="pose"):
    """Bring the tip to a pose; tolerances are in the goal's own frame [m, rad], null leaves an axis free."""

    position: Vector3
    quaternion_xyzw: QuaternionXYZW
    position_tolerance: Tolerance3 = (1e-4, 1e-4, 1e-4)
    orientation_tolerance: Tolerance3 = (1e-3, 1e-3, 1e-3)

    def __post_init__(self) -> None:
        require_finite("position", self.position)
        require_unit_quaternion("quaternion_xyzw", self.quaternion_xyzw)
        require_finite("position_tolerance", (x for x in self.position_tolerance if x is not None))
        require_finite("orientation_tolerance", (x for x in self.orientation_tolerance if x is not None))


class GuidePlaneGoal(Message, tag_field="type", tag="guide_plane"):
    """Reach the last guide plane with the tip: the seed's own kind of goal."""


Goal = JointsGoal | JointSetGoal | PoseGoal | GuidePlaneGoal


class AttachedObject(Message):
    """An object held by a link; it may touch the links named in `touch_links`."""

    obstacle: Obstacle
    link: Name
    placement: Placement = Placement()
    touch_links: list[Name] = []


class OrientationCone(Message, tag_field="type", tag="orientation_cone"):
    """Keep an axis of a frame within a cone about a world direction [rad]."""

    frame: Name
    axis: Vector3
    target_axis: Vector3
    half_angle: Positive


class PlaneConstraint(Message, tag_field="type", tag="plane"):
    """Keep a frame's origin on a plane within a tolerance [m]."""

    frame: Name
    point: Vector3
    normal: Vector3
    tolerance: Positive


class LineConstraint(Message, tag_field="type", tag="line"):
    """Keep a frame's origin on a line within a tolerance [m]."""

    frame: Name
    point: Vector3
    direction: Vector3
    tolerance: Positive


PathConstraint = OrientationCone | PlaneConstraint | LineConstraint


class JointLimits(Message):
    """Limits of one joint's motion that replace the robot's own [rad or m, per s, s^2, s^3]."""

    velocity: Positive | None = None
    acceleration: Positive | None = None
    jerk: Positive | None = None

    def __post_init__(self) -> None:
        require_finite("limits", (x for x in (self.velocity, self.acceleration, self.jerk) if x is not None))


class PlanRequest(Message):
    """Ask for a motion: a certified, timed path from `start` to `goal`."""

    robot: RobotReference
    scene: SceneReference
    goal: Goal
    schema: Literal[1] = 1
    run_id: RunId | None = None
    robot_placement: Placement = Placement()
    group: str | list[Name] | None = None
    tip: Name | None = None
    start: Positions = {}
    guide_planes: list[GuidePlane] | Literal["auto"] | None = None
    planner: Literal["auto", "guided", "tree"] = "auto"
    minimizer: Literal["projected", "univariate"] = "projected"
    min_clearance: NonNegative = 0.0
    attached_objects: list[AttachedObject] = []
    allowed_collisions: list[tuple[Name, Name]] = []
    path_constraints: list[PathConstraint] = []
    limits: dict[str, JointLimits] = {}
    max_velocity_scaling_factor: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)] = 1.0
    max_acceleration_scaling_factor: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)] = 1.0
    allowed_planning_time: Annotated[float, msgspec.Meta(gt=0.0, le=3600.0)] = 5.0
    optimization_iterations: Annotated[int, msgspec.Meta(ge=0, le=1_000_000)] | None = None
    leave_start_contact: bool = False
    sample_rate: Annotated[float, msgspec.Meta(gt=0.0, le=10_000.0)] | None = None
    recording: Literal["full", "summary", "off"] = "full"
    seed: Annotated[int, msgspec.Meta(ge=0, le=2**53)] = 0

    def __post_init__(self) -> None:
        require_finite_positions("start", self.start)
        if not math.isfinite(self.min_clearance):
            raise ValueError(f"`min_clearance` must be a finite number, got {self.min_clearance}")


class ForwardKinematics(Message, tag_field="type", tag="forward_kinematics"):
    """Placements of frames at configurations."""

    robot: RobotReference
    frames: Annotated[list[Name], msgspec.Meta(min_length=1, max_length=1_000)]
    configurations: Annotated[list[Positions], msgspec.Meta(max_length=100_000)]
    schema: Literal[1] = 1
    robot_placement: Placement = Placement()

    def __post_init__(self) -> None:
        _check_configurations(self.configurations)


class TargetPose(Message):
    """A pose for inverse kinematics; tolerances as in `PoseGoal`."""

    position: Vector3
    quaternion_xyzw: QuaternionXYZW
    position_tolerance: Tolerance3 = (0.0, 0.0, 0.0)
    orientation_tolerance: Tolerance3 = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        require_finite("position", self.position)
        require_unit_quaternion("quaternion_xyzw", self.quaternion_xyzw)


class InverseKinematics(Message, tag_field="type", tag="inverse_kinematics"):
    """Distinct configurations that bring the tip to each pose."""

    robot: RobotReference
    poses: Annotated[list[TargetPose], msgspec.Meta(max_length=10_000)]
    schema: Literal[1] = 1
    robot_placement: Placement = Placement()
    tip: Name | None = None
    group: str | list[Name] | None = None
    scene: SceneReference | None = None
    collision_free: bool = False
    start_configurations: Annotated[list[Positions], msgspec.Meta(max_length=10_000)] = []
    solutions: Annotated[int, msgspec.Meta(ge=1, le=1_000)] = 8
    seed: Annotated[int, msgspec.Meta(ge=0, le=2**53)] = 0

    def __post_init__(self) -> None:
        _check_configurations(self.start_configurations)


class Clearance(Message, tag_field="type", tag="clearance"):
    """Distance of the robot's moving links to the obstacles, and to themselves, at configurations."""

    robot: RobotReference
    scene: SceneReference
    configurations: Annotated[list[Positions], msgspec.Meta(max_length=100_000)]
    schema: Literal[1] = 1
    robot_placement: Placement = Placement()

    def __post_init__(self) -> None:
        _check_configurations(self.configurations)


class Potential(Message, tag_field="type", tag="potential"):
    """The field of a scene at points (a unit point charge each), or on a robot at configurations."""

    scene: SceneReference
    schema: Literal[1] = 1
    points: Annotated[list[Vector3], msgspec.Meta(max_length=1_000_000)] | None = None
    robot: RobotReference | None = None
    robot_placement: Placement = Placement()
    configurations: Annotated[list[Positions], msgspec.Meta(max_length=100_000)] | None = None

    def __post_init__(self) -> None:
        by_points = self.points is not None
        by_robot = self.robot is not None and self.configurations is not None
        if by_points == by_robot or (self.robot is None) != (self.configurations is None):
            raise ValueError("give either `points`, or `robot` with `configurations`")
        for index, point in enumerate(self.points or ()):
            require_finite(f"points[{index}]", point)
        _check_configurations(self.configurations or [])


KinematicsRequest = ForwardKinematics | InverseKinematics | Clearance | Potential
TaggedRequest = KinematicsRequest | StoreRequest
Request = PlanRequest | TaggedRequest


def _check_configurations(configurations: list[Positions]) -> None:
    for index, positions in enumerate(configurations):
        require_finite_positions(f"configurations[{index}]", positions)
