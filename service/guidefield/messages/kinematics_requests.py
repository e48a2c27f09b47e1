"""Requests about configurations, poses and points, one or a batch of them in one request.

Names, order, defaults and meanings of fields are the wire and the Python API: a new one comes last. Docstrings of
messages, and the largest numbers here, are in docs/wire.md and the schemas: after a change, `tools/wire_page`.
"""

from __future__ import annotations

import math
import sys
from array import array
from collections.abc import Sequence
from itertools import chain
from typing import Annotated, Literal

import msgspec

from guidefield.messages.conditions import (
    AllowedCollisions,
    AttachedObjects,
    RobotReference,
    SceneReference,
    settle_scene,
)
from guidefield.messages.scene import VALUES_PER_CHECK
from guidefield.messages.values import (
    LARGEST,
    NO_INERTIA,
    ORIGIN,
    AllowedTime,
    InertiaTensor,
    Mass,
    Message,
    Name,
    Placement,
    Positions,
    QuaternionXYZW,
    RunId,
    Tolerance3,
    Vector3,
    require_finite,
    require_finite_configurations,
    require_finite_number,
    require_load,
    require_unit_quaternion,
)

DEFAULT_TIME = 60.0
"""Default of the allowed time of a request [s]."""

MOST_CONFIGURATIONS = 100_000
"""The largest number of configurations of a request."""
MOST_POSES = 10_000
"""The largest number of poses of a request."""
MOST_STARTS = 10_000
"""The largest number of configurations from which a search may start."""
MOST_POINTS = 1_000_000
"""The largest number of points of a request."""
MOST_COLUMNS = 2_000
"""The largest number of columns of a table of configurations."""


class ConfigurationTable(Message):
    """Configurations as the rows of a table: smaller and faster to decode than one object for each.

    Attributes:
        names: The columns, named as in `position_names` of a plan's reply, in any order.
        rows: A row for each configuration [rad, m, or entries of a quaternion].
        float64: Instead of `rows` the same numbers packed row by row: little-endian float64, as bytes in MessagePack
            and base64 text in JSON.
    """

    names: Annotated[list[Name], msgspec.Meta(min_length=1, max_length=MOST_COLUMNS)]
    rows: Annotated[list[list[float]], msgspec.Meta(max_length=MOST_CONFIGURATIONS)] | None = None
    float64: bytes | None = None

    def __post_init__(self) -> None:
        if (self.rows is None) == (self.float64 is None):
            raise ValueError("give either `rows` or `float64`")
        width = len(self.names)
        if self.float64 is not None:
            require_packed_rows("float64", self.float64, width, MOST_CONFIGURATIONS)
        for index, row in enumerate(self.rows or ()):
            if len(row) != width:
                raise ValueError(f"`rows[{index}]` has {len(row)} values, but there are {width} `names`")
            if not math.hypot(*row) <= LARGEST:
                require_finite(f"rows[{index}]", row)


ConfigurationBatch = Annotated[list[Positions], msgspec.Meta(max_length=MOST_CONFIGURATIONS)] | ConfigurationTable


JointRates = Annotated[list[Positions], msgspec.Meta(max_length=MOST_CONFIGURATIONS)] | ConfigurationTable
"""Velocities or accelerations of joints, in the tangent space: a number, or the list of a joint with several (planar:
[vx, vy, wz]; spherical: [wx, wy, wz]; floating: [vx, vy, vz, wx, wy, wz]; in the moved frame)."""


def count_configurations(configurations: ConfigurationBatch) -> int:
    """Return the number of configurations."""
    if not isinstance(configurations, ConfigurationTable):
        return len(configurations)
    if configurations.float64 is not None:
        return len(configurations.float64) // (8 * len(configurations.names))
    return len(configurations.rows or ())


def require_rates(field: str, rates: JointRates | None, configurations: ConfigurationBatch) -> None:
    """Raise ValueError unless there is a finite rate for each configuration, or none at all."""
    if rates is None:
        return
    given, needed = count_configurations(rates), count_configurations(configurations)
    if given != needed:
        raise ValueError(f"`{field}` must have one for each of the {needed} configurations, not {given}")
    require_finite_batch(field, rates)


def require_packed_rows(field: str, packed: bytes, width: int, most: int) -> None:
    """Raise ValueError unless packed float64 numbers are finite, and whole rows of a width, at most `most` of them."""
    if len(packed) % (8 * width):
        raise ValueError(f"`{field}` must hold whole rows of {width} numbers ({8 * width} bytes), not {len(packed)}")
    if len(packed) > 8 * width * most:
        raise ValueError(f"`{field}` may hold {most} rows, got {len(packed) // (8 * width)}")
    numbers = array("d", packed)
    if sys.byteorder == "big":
        numbers.byteswap()
    for begin in range(0, len(numbers), VALUES_PER_CHECK):
        if not math.hypot(*numbers[begin : begin + VALUES_PER_CHECK]) <= LARGEST:
            for index, number in enumerate(numbers[begin : begin + VALUES_PER_CHECK], begin):
                row, column = divmod(index, width)
                require_finite_number(f"{field}[{row}][{column}]", number)


def require_finite_batch(field: str, configurations: ConfigurationBatch) -> None:
    """Raise ValueError if a joint value of listed configurations isn't finite; a table checks its own."""
    if not isinstance(configurations, ConfigurationTable):
        require_finite_configurations(field, configurations)


class ForwardKinematics(Message, tag_field="type", tag="forward_kinematics"):
    """Placements of frames at configurations.

    Attributes:
        robot: The robot.
        frames: Their names.
        configurations: Joints left out are at the robot's rest configuration.
        robot_placement: Of the robot's root in the world.
        packed: Whether the reply packs its numbers.
        request_id: A name by which it can be cancelled; null: none.
        allowed_time: From the request's arrival, queue and loading included [s].
    """

    robot: RobotReference
    frames: Annotated[list[Name], msgspec.Meta(min_length=1, max_length=1_000)]
    configurations: ConfigurationBatch
    schema: Literal[1] = 1
    robot_placement: Placement = Placement()
    packed: bool = False
    request_id: RunId | None = None
    allowed_time: AllowedTime = DEFAULT_TIME

    def __post_init__(self) -> None:
        require_finite_batch("configurations", self.configurations)


class TargetPose(Message):
    """A pose for inverse kinematics; the fields are those of `PoseGoal`, a tolerance of 0 means rounding error."""

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
        robot_placement: Of the robot's root in the world.
        tip: Name of the frame that reaches the poses; null: the robot's own.
        group: Joints that may move, as in `PlanRequest`.
        scene: The obstacles.
        collision_free: Whether solutions must be free of collision.
        attached_objects: Objects held by links; with `collision_free` they must touch nothing either.
        allowed_collisions: Pairs of links and obstacles that may touch.
        start_configurations: Starts of the search, before random ones; joints outside the group are as in the first.
        solutions: The number of solutions to search for at each pose.
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
        configurations: Joints left out are at the robot's rest configuration.
        robot_placement: Of the robot's root in the world.
        attached_objects: Objects held by links; they are measured as links.
        allowed_collisions: Pairs of links and obstacles that may touch, and aren't measured.
        contacts: Whether the reply lists the pairs in contact.
        verdict: Whether the reply has only `free`, in a fraction of the time; its other lists are empty.
        gradients: Whether the reply has the gradients of both distances by the joints.
        packed: Whether the reply packs its numbers.
        request_id: A name by which it can be cancelled; null: none.
        allowed_time: From the request's arrival, queue and loading included [s].
    """

    robot: RobotReference
    scene: SceneReference
    configurations: ConfigurationBatch
    schema: Literal[1] = 1
    robot_placement: Placement = Placement()
    attached_objects: AttachedObjects = []
    allowed_collisions: AllowedCollisions = []
    contacts: bool = False
    verdict: bool = False
    gradients: bool = False
    packed: bool = False
    request_id: RunId | None = None
    allowed_time: AllowedTime = DEFAULT_TIME

    def __post_init__(self) -> None:
        settle_scene(self)
        require_finite_batch("configurations", self.configurations)
        if self.verdict and (self.contacts or self.gradients):
            raise ValueError(
                "`verdict` asks whether configurations are free alone: leave out `contacts` and `gradients`"
            )


class Potential(Message, tag_field="type", tag="potential"):
    """The field of a scene at points (a unit point charge each), or on a robot at configurations.

    Attributes:
        scene: The charged obstacles.
        points: The points [m, world].
        robot: The robot, if no points are given.
        robot_placement: Of its root in the world.
        configurations: Joints left out are at the robot's rest configuration.
        request_id: A name by which it can be cancelled; null: none.
        allowed_time: From the request's arrival, queue and loading included [s].
    """

    scene: SceneReference
    schema: Literal[1] = 1
    points: Annotated[list[Vector3], msgspec.Meta(max_length=MOST_POINTS)] | None = None
    robot: RobotReference | None = None
    robot_placement: Placement = Placement()
    configurations: ConfigurationBatch | None = None
    request_id: RunId | None = None
    allowed_time: AllowedTime = DEFAULT_TIME

    def __post_init__(self) -> None:
        settle_scene(self)
        by_points = self.points is not None
        by_robot = self.robot is not None and self.configurations is not None
        if by_points == by_robot or (self.robot is None) != (self.configurations is None):
            raise ValueError("give either `points`, or `robot` with `configurations`")
        require_finite_points("points", self.points or ())
        require_finite_batch("configurations", self.configurations or [])


ReferenceFrame = Literal["local", "world", "local_world_aligned"]
"""Frame in which twists are expressed, by Pinocchio's names: in the frame's own axes at its origin, in the world's
axes at the world's origin, or in the world's axes at the frame's origin."""


class Jacobian(Message, tag_field="type", tag="jacobian"):
    """Jacobians of frames at configurations: their twists by the velocities of the joints.

    Attributes:
        robot: The robot.
        frames: Their names.
        configurations: Joints left out are at the robot's rest configuration.
        robot_placement: Of the robot's root in the world.
        reference_frame: The frame in which twists are expressed.
        velocities: Velocities of the joints, one for each configuration in the reply's columns [rad/s or m/s]: the
            reply has the frames' twists, too. A joint left out stands still.
        packed: Whether the reply packs its numbers.
        request_id: A name by which it can be cancelled; null: none.
        allowed_time: From the request's arrival, queue and loading included [s].
    """

    robot: RobotReference
    frames: Annotated[list[Name], msgspec.Meta(min_length=1, max_length=1_000)]
    configurations: ConfigurationBatch
    schema: Literal[1] = 1
    robot_placement: Placement = Placement()
    reference_frame: ReferenceFrame = "local_world_aligned"
    velocities: JointRates | None = None
    packed: bool = False
    request_id: RunId | None = None
    allowed_time: AllowedTime = DEFAULT_TIME

    def __post_init__(self) -> None:
        require_finite_batch("configurations", self.configurations)
        require_rates("velocities", self.velocities, self.configurations)


class Payload(Message):
    """A rigid load on a link, for dynamics.

    Attributes:
        link: The link that carries it.
        mass: Its mass [kg].
        centre_of_mass: In the link's frame [m].
        inertia: Ixx, Ixy, Ixz, Iyy, Iyz, Izz about its centre of mass, in the axes of the link's frame [kg m^2].
    """

    link: Name
    mass: Mass
    centre_of_mass: Vector3 = ORIGIN
    inertia: InertiaTensor = NO_INERTIA

    def __post_init__(self) -> None:
        require_load(self.mass, self.centre_of_mass, self.inertia)


DynamicsQuantity = Literal["inverse_dynamics", "gravity", "mass_matrix", "centre_of_mass"]


class Dynamics(Message, tag_field="type", tag="dynamics"):
    """Rigid-body dynamics at configurations, without friction and the inertia of rotors.

    Attributes:
        robot: The robot; it needs `<inertial>` elements.
        configurations: Joints left out are at the robot's rest configuration.
        quantities: The results: "inverse_dynamics", the torques or forces that drive the joints with the given
            velocities and accelerations; "gravity", those that hold the robot still; "mass_matrix";
            "centre_of_mass", of the whole robot and its payload, in the world.
        robot_placement: Of the robot's root in the world.
        velocities: Of the joints, one for each configuration [rad/s or m/s]; null: they are zero.
        accelerations: The same [rad/s^2 or m/s^2].
        gravity: Acceleration of free fall [m/s^2, world].
        payload: Loads on links.
        packed: Whether the reply packs its numbers.
        request_id: A name by which it can be cancelled; null: none.
        allowed_time: From the request's arrival, queue and loading included [s].
    """

    robot: RobotReference
    configurations: ConfigurationBatch
    quantities: Annotated[list[DynamicsQuantity], msgspec.Meta(min_length=1, max_length=4)]
    schema: Literal[1] = 1
    robot_placement: Placement = Placement()
    velocities: JointRates | None = None
    accelerations: JointRates | None = None
    gravity: Vector3 = (0.0, 0.0, -9.81)
    payload: Annotated[list[Payload], msgspec.Meta(max_length=1_000)] = []
    packed: bool = False
    request_id: RunId | None = None
    allowed_time: AllowedTime = DEFAULT_TIME

    def __post_init__(self) -> None:
        require_finite_batch("configurations", self.configurations)
        require_rates("velocities", self.velocities, self.configurations)
        require_rates("accelerations", self.accelerations, self.configurations)
        require_finite("gravity", self.gravity)
        if self.accelerations is not None and "inverse_dynamics" not in self.quantities:
            raise ValueError("`accelerations` are for `inverse_dynamics`, which `quantities` doesn't have")


KinematicsRequest = ForwardKinematics | InverseKinematics | Clearance | Potential | Jacobian | Dynamics


def require_finite_points(field: str, points: Sequence[Vector3]) -> None:
    """Raise ValueError if a number is NaN, infinite or too large."""
    for begin in range(0, len(points), VALUES_PER_CHECK):
        some = points[begin : begin + VALUES_PER_CHECK]
        if not math.hypot(*chain.from_iterable(some)) <= LARGEST:  # the norm of all is at least that of each
            for index, point in enumerate(some, begin):
                require_finite(f"{field}[{index}]", point)
