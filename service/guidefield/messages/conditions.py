"""Fields that requests about motions share: conditions of the motion, and held objects."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from guidefield.messages.scene import Obstacle
from guidefield.messages.values import (
    Message,
    Name,
    Placement,
    Positive,
    Vector3,
    require_finite_number,
)

MOST_HELD = 1_000
"""The largest number of held objects."""
MOST_PAIRS = 100_000
"""The largest number of allowed pairs of links and obstacles."""
MOST_CONSTRAINTS = 100
"""The largest number of path constraints of a motion."""

Objective = Literal["balanced", "time", "clearance"]
"""The quantity for which a motion is optimised."""


class AttachedObject(Message):
    """An object held by a link.

    Attributes:
        obstacle: Its shape; replies name the object by the shape's name.
        link: The link that holds it.
        placement: Of its frame in the link's frame.
        touch_links: Further links that it may touch.
    """

    obstacle: Obstacle
    link: Name
    placement: Placement = Placement()
    touch_links: list[Name] = []


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
    point: Vector3
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
    point: Vector3
    direction: Vector3
    tolerance: Positive


PathConstraint = OrientationCone | PlaneConstraint | LineConstraint

AttachedObjects = Annotated[list[AttachedObject], msgspec.Meta(max_length=MOST_HELD)]
AllowedCollisions = Annotated[list[tuple[Name, Name]], msgspec.Meta(max_length=MOST_PAIRS)]
PathConstraints = Annotated[list[PathConstraint], msgspec.Meta(max_length=MOST_CONSTRAINTS)]


class JointLimits(Message):
    """Limits of one joint's motion that replace the robot's own; null keeps them.

    Attributes:
        velocity: [rad/s or m/s].
        acceleration: [rad/s^2 or m/s^2].
        jerk: [rad/s^3 or m/s^3]; null for none.
    """

    velocity: Positive | None = None
    acceleration: Positive | None = None
    jerk: Positive | None = None

    def __post_init__(self) -> None:
        for field in ("velocity", "acceleration", "jerk"):
            if (limit := getattr(self, field)) is not None:
                require_finite_number(field, limit)
