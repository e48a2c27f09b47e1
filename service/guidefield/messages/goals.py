"""Configurations and goals of requests; the relative goal, which only steps have, is in requests.py."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated

import msgspec

from guidefield.messages.values import (
    LARGEST,
    Message,
    NonNegative,
    QuaternionXYZW,
    Vector3,
    require_finite,
    require_finite_number,
    require_unit_quaternion,
)

MOST_GOALS = 10_000
"""The largest number of configurations of a `JointSetGoal`."""

JointValue = float | list[float]
Positions = dict[str, JointValue]
"""A configuration: joint name to value.

Revolute and prismatic joints: a number [rad or m]; continuous: an angle [rad] modulo whole turns; planar: [x, y,
theta]; spherical: a unit quaternion (x, y, z, w); floating: [x, y, z, qx, qy, qz, qw]. A planar or floating root is
`root_joint`. Mimic joints are left out: they are at multiplier * value + offset. If a whole turn of a continuous joint
moves one of its mimic joints elsewhere, the joint is listed as revolute, and its whole turns count.
"""

Tolerance3 = tuple[NonNegative | None, NonNegative | None, NonNegative | None]
"""Tolerances along or about three axes; None leaves an axis free."""


def require_finite_positions(field: str, positions: Positions) -> None:
    """Raise ValueError if a joint value is NaN or infinite; `field` names the configuration."""
    try:
        if math.hypot(*positions.values()) <= LARGEST:  # type: ignore[arg-type] # as is each: there may be thousands
            return
    except TypeError:  # a joint has several coordinates
        pass
    for joint, value in positions.items():
        if isinstance(value, list):
            require_finite(f"{field}.{joint}", value)
        else:
            require_finite_number(f"{field}.{joint}", value)


def require_finite_configurations(field: str, configurations: Sequence[Positions]) -> None:
    """Raise ValueError if a joint value of a configuration is NaN or infinite; `field` names their list."""
    for index, positions in enumerate(configurations):
        require_finite_positions(f"{field}[{index}]", positions)


class JointsGoal(Message, tag_field="type", tag="joints"):
    """Reach one configuration.

    Attributes:
        positions: The configuration; joints left out keep their value at the start.
    """

    positions: Positions

    def __post_init__(self) -> None:
        require_finite_positions("positions", self.positions)


class JointSetGoal(Message, tag_field="type", tag="joint_set"):
    """Reach any one of several configurations.

    Attributes:
        positions: The configurations, each as in `JointsGoal`.
    """

    positions: Annotated[list[Positions], msgspec.Meta(min_length=1, max_length=MOST_GOALS)]

    def __post_init__(self) -> None:
        require_finite_configurations("positions", self.positions)


class PoseGoal(Message, tag_field="type", tag="pose"):
    """Bring the tip to a pose.

    Attributes:
        position: Of the tip [m, world].
        quaternion_xyzw: Its rotation in the world.
        position_tolerance: Largest offset along each axis of the goal's own frame [m]; null leaves an axis free.
        orientation_tolerance: Largest components of the rotation vector in that frame [rad]; null leaves one free.
    """

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
    """Reach the last guide plane with the tip, at any point of it and in any orientation."""


Goal = JointsGoal | JointSetGoal | PoseGoal | GuidePlaneGoal
