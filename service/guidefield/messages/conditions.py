"""Parts that requests about motions and configurations share: robot and scene, conditions, held objects, limits.

Names, order, defaults and meanings of fields are the wire and the Python API: a new one comes last. Docstrings of
messages, and the largest numbers here, are in docs/wire.md and the schemas: after a change, `tools/wire_page`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

import msgspec

from guidefield.messages.scene import Obstacle, Scene
from guidefield.messages.scene_changes import RequestScene
from guidefield.messages.values import (
    NO_INERTIA,
    ORIGIN,
    InertiaTensor,
    Mass,
    Message,
    Name,
    Placement,
    Positive,
    RootJoint,
    UrdfCharacters,
    Vector3,
    WorldPoint,
    require_limit,
    require_load,
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
