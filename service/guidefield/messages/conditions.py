"""Parts that requests share: robot, scene, conditions, held objects, limits; configurations, poses, and packed numbers.

Names, order, defaults and meanings of fields are the wire and the Python API: a new one comes last. Docstrings of
messages, and the largest numbers here, are in docs/wire.schema.json: after a change, `tools/wire_page`.
"""

from __future__ import annotations

import math
import sys
from array import array
from collections.abc import Sequence
from itertools import chain
from typing import TYPE_CHECKING, Annotated, Literal

import msgspec

from guidefield.messages.scene import VALUES_PER_CHECK, Obstacle, Scene
from guidefield.messages.scene_changes import RequestScene
from guidefield.messages.values import (
    LARGEST,
    NO_INERTIA,
    ORIGIN,
    InertiaTensor,
    Mass,
    Message,
    Name,
    Placement,
    Positions,
    Positive,
    QuaternionXYZW,
    Reply,
    RootJoint,
    Tolerance3,
    UrdfCharacters,
    Vector3,
    WorldPoint,
    require_finite,
    require_finite_configurations,
    require_finite_number,
    require_limit,
    require_load,
    require_unit_quaternion,
)


class UrdfText(Message, tag_field="type", tag="urdf"):
    """A robot sent as text.

    Attributes:
        text: Its URDF; meshes must come from packages that the service allows.
        srdf: Its SRDF.
        root_joint: Joint between the world and its root link.
    """

    text: UrdfCharacters
    srdf: UrdfCharacters | None = None
    root_joint: RootJoint = "fixed"


class UrdfFile(Message, tag_field="type", tag="urdf_file"):
    """A robot in local files; only in Python and on the command line, refused from the wire.

    Attributes:
        path: Its URDF, a file that ends in `.xacro`, or an MJCF.
        srdf_path: Its SRDF.
        package_dirs: Folders that hold the packages of its meshes.
        root_joint: Joint between the world and its root link.
        xacro_args: Arguments of a `.xacro` file by name.
    """

    path: str
    srdf_path: str | None = None
    package_dirs: list[str] = []
    root_joint: RootJoint = "fixed"
    xacro_args: dict[str, str | bool | int | float] = {}


ROBOT_DESCRIPTIONS = "robot_descriptions:"
"""Prefix of robots of the package robot_descriptions; only in Python and on the command line."""

RobotReference = str | UrdfText | UrdfFile
if TYPE_CHECKING:
    SceneReference = str | Scene
else:  # the decoder makes a RequestScene of both forms, and `settle_scene` a Scene of one without a base
    SceneReference = str | RequestScene


def settle_scene(request: msgspec.Struct) -> None:
    """Replace a RequestScene without a base by the plain scene, while its request is constructed."""
    scene = getattr(request, "scene", None)
    if isinstance(scene, RequestScene) and scene.base is None:
        msgspec.structs.force_setattr(request, "scene", scene.declared)


MOST_HELD = 1_000
"""The largest number of held objects."""
MOST_PAIRS = 100_000
"""The largest number of allowed pairs of links and obstacles; docs/goals.md tells it, too."""
MOST_CONSTRAINTS = 100
"""The largest number of path constraints of a motion, and of its Cartesian limits."""

Objective = Literal["balanced", "time", "clearance"]
"""The quantity for which a motion is optimised: duration, clearance, or both in balance."""


class AttachedObject(Message):
    """An object held by a link.

    Attributes:
        obstacle: Its shape; replies name the object by the shape's name.
        link: The link that holds it.
        placement: Of its frame in the link's frame.
        touch_links: Further links that it may touch.
        mass: Its mass [kg]; null: nothing of it counts in torques.
        centre_of_mass: In the shape's own frame, that of its `position` and `quaternion_xyzw` [m].
        inertia: Ixx, Ixy, Ixz, Iyy, Iyz, Izz about its centre of mass, in the axes of that frame [kg m^2].
    """

    obstacle: Obstacle
    link: Name
    placement: Placement = Placement()
    touch_links: list[Name] = []
    mass: Mass | None = None
    centre_of_mass: Vector3 = ORIGIN
    inertia: InertiaTensor = NO_INERTIA

    def __post_init__(self) -> None:
        require_load(self.mass, self.centre_of_mass, self.inertia)


class OrientationCone(Message, tag_field="type", tag="orientation_cone"):
    """Keep an axis of a frame within a cone.

    Attributes:
        frame: The frame.
        axis: The axis in the frame, of any length but 0.
        target_axis: The cone's axis in the world, of any length but 0.
        half_angle: Largest angle between them [rad].
    """

    frame: Name
    axis: Vector3
    target_axis: Vector3
    half_angle: Positive


class PlaneConstraint(Message, tag_field="type", tag="plane"):
    """Keep a frame's origin near a plane.

    Attributes:
        frame: The frame.
        point: On the plane [m, world].
        normal: Of the plane, in the world, of any length but 0.
        tolerance: Largest distance [m].
    """

    frame: Name
    point: WorldPoint
    normal: Vector3
    tolerance: Positive


class LineConstraint(Message, tag_field="type", tag="line"):
    """Keep a frame's origin near a line.

    Attributes:
        frame: The frame.
        point: On the line [m, world].
        direction: Of the line, in the world, of any length but 0.
        tolerance: Largest distance [m].
    """

    frame: Name
    point: WorldPoint
    direction: Vector3
    tolerance: Positive


PathConstraint = OrientationCone | PlaneConstraint | LineConstraint

AttachedObjects = Annotated[list[AttachedObject], msgspec.Meta(max_length=MOST_HELD)]
AllowedCollisions = Annotated[list[tuple[Name, Name]], msgspec.Meta(max_length=MOST_PAIRS)]
PathConstraints = Annotated[list[PathConstraint], msgspec.Meta(max_length=MOST_CONSTRAINTS)]


class CartesianLimit(Message):
    """A limit of speed in space, kept along the whole motion: of a frame's origin, or of a link.

    Of a link its fastest point counts: of its collision geometry, or of an object that is held, by the object's name.

    Attributes:
        speed: Largest speed, in the world [m/s].
        frame: The frame; null: there is a `link`.
        link: The link, or the held object; null: there is a `frame`.
        acceleration: Largest acceleration of these points [m/s^2]; null for none.
    """

    speed: Positive
    frame: Name | None = None
    link: Name | None = None
    acceleration: Positive | None = None

    def __post_init__(self) -> None:
        if (self.frame is None) == (self.link is None):
            raise ValueError(f"give a `frame` or a `link`, got {'neither' if self.link is None else 'both'}")
        for field in ("speed", "acceleration"):
            require_limit(field, getattr(self, field))


CartesianLimits = Annotated[list[CartesianLimit], msgspec.Meta(max_length=MOST_CONSTRAINTS)]


class JointLimits(Message):
    """Limits of one joint's motion that replace the robot's own.

    Attributes:
        velocity: [rad/s or m/s]; null: the robot's own.
        acceleration: [rad/s^2 or m/s^2]; null: the robot's own.
        jerk: [rad/s^3 or m/s^3]; null for none.
        effort: Torque or force that drives it [N m or N]; null for none: the robot's own is only reported.
    """

    velocity: Positive | None = None
    acceleration: Positive | None = None
    jerk: Positive | None = None
    effort: Positive | None = None

    def __post_init__(self) -> None:
        for field in ("velocity", "acceleration", "jerk", "effort"):
            require_limit(field, getattr(self, field))


MOST_POSES = 10_000
"""The largest number of poses of a request."""
MOST_STARTS = 10_000
"""The largest number of configurations from which a search may start."""
MOST_POINTS = 1_000_000
"""The largest number of points of a request."""
MOST_CONFIGURATIONS = 100_000
"""The largest number of configurations of a request."""
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


class TargetPose(Message):
    """A pose for inverse kinematics; the fields are those of `PoseGoal`, a tolerance of 0 means rounding error."""

    position: WorldPoint
    quaternion_xyzw: QuaternionXYZW
    position_tolerance: Tolerance3 = (0.0, 0.0, 0.0)
    orientation_tolerance: Tolerance3 = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        require_finite("position", self.position)
        require_unit_quaternion("quaternion_xyzw", self.quaternion_xyzw)


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


class PackedNumbers(Reply):
    """Numbers packed row by row.

    Attributes:
        shape: The size along each axis.
        float64: Little-endian float64: bytes in MessagePack and in Python, base64 text in JSON.

    Examples:
        >>> import numpy as np
        >>> from guidefield.messages.replies import PackedNumbers
        >>> packed = PackedNumbers(shape=[2, 1], float64=np.array([[0.5], [1.5]]).tobytes())
        >>> np.frombuffer(packed.float64, "<f8").reshape(packed.shape).tolist()
        [[0.5], [1.5]]
    """

    shape: list[int]
    float64: bytes


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


def require_finite_points(field: str, points: Sequence[Vector3]) -> None:
    """Raise ValueError if a number is NaN, infinite or too large."""
    for begin in range(0, len(points), VALUES_PER_CHECK):
        some = points[begin : begin + VALUES_PER_CHECK]
        if not math.hypot(*chain.from_iterable(some)) <= LARGEST:  # the norm of all is at least that of each
            for index, point in enumerate(some, begin):
                require_finite(f"{field}[{index}]", point)
